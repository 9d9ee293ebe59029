"""Elements that cannot be meant, found when a map is read (room: maps; host).

In: an element, or a map as its reader made it. Out: what is wrong; the map without such elements, each named.
One corner 4,000 km away makes every query hold a contour around the earth; the rest of the map is as good as before.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from semloc_jax.maps.elements import LARGEST_M, UPRIGHT_CLASSES, MapElement
from semloc_jax.maps.heights import SIGMA
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.structs import ElementClass

_LONGEST_STEP_M = 20_000.0
"""From one vertex of a line to the next; longer than any straight road; ours."""
_LONGEST_LINE_M = 200_000.0
"""Of one line; longer than any road without a crossing; ours."""
_WHOLE = UPRIGHT_CLASSES | {
    *(ElementClass.CROSSWALK, ElementClass.SIGN, ElementClass.ROAD_MARK, ElementClass.PARKING_SLOT),
    *(ElementClass.PILLAR, ElementClass.SPEED_BUMP),
}
"""Classes of things that no query cuts."""
_MOST_TOLD = 5
_AT_ONCE = 64
_log = logging.getLogger(__name__)


def fault_of(element: MapElement) -> str | None:
    """What is wrong with an element on its own; None where nothing is."""
    told = _fault_of_words(element.attributes)
    if told is not None:
        return told
    points = element.points
    if element.closed or element.label in _WHOLE:
        size_m = float(np.ptp(points, axis=0).max())
        if size_m > LARGEST_M:
            return f"{element.label.name} of {len(points)} points is {size_m / 1e3:.4g} km across"
    elif len(points) > 1:
        step_m = float(np.abs(np.diff(points, axis=0)).max())
        if step_m > _LONGEST_STEP_M:
            return f"{element.label.name} jumps {step_m / 1e3:.4g} km from one vertex to the next"
        if len(points) * step_m > _LONGEST_LINE_M and element.length_m > _LONGEST_LINE_M:
            return f"{element.label.name} of {len(points)} points is {element.length_m / 1e3:.4g} km long"
    return None


def _fault_of_words(attributes: Mapping[str, Any]) -> str | None:
    """What is wrong with the attributes that are computed with: a file may hold anything there."""
    sigma_m, assumed = attributes.get(SIGMA, 0.0), attributes.get("assumed", ())
    if not (isinstance(sigma_m, int | float) and 0.0 <= sigma_m < LARGEST_M):
        return f"{SIGMA} is {repr(sigma_m)[:40]}; expected metres from 0 to {LARGEST_M:g}"
    if not (isinstance(assumed, list | tuple) and all(isinstance(word, str) for word in assumed)):
        return f"'assumed' is {repr(assumed)[:40]}; expected a list of words"
    return None


def faults_of(elements: Sequence[MapElement]) -> dict[int, str]:
    """What is wrong with elements on their own, by their places in the list; see `fault_of`."""
    return {row: fault for row in _suspicious(elements) if (fault := fault_of(elements[row])) is not None}


def sound(semantic_map: SemanticMap) -> SemanticMap:
    """The map without faulty elements, which `faulty` names; the first of them are logged."""
    elements = semantic_map.elements
    faults = faults_of(elements)
    faulty = {**semantic_map.faulty, **{elements[row].id: fault for row, fault in faults.items()}}
    tell(faulty, semantic_map.name)
    if not faults:
        return semantic_map
    kept = tuple(element for row, element in enumerate(elements) if row not in faults)
    return replace(semantic_map, elements=kept, faulty=faulty)


def _suspicious(elements: Sequence[MapElement]) -> Iterator[int]:
    """Places in the list of elements with odd words, or a box that is large enough for a fault; of most it is not."""
    for start in range(0, len(elements), _AT_ONCE):
        some = elements[start : start + _AT_ONCE]
        count = np.array([len(element.points) for element in some])
        points, first = np.concatenate([element.points for element in some]), np.cumsum(count) - count
        sides_m = np.maximum.reduceat(points, first) - np.minimum.reduceat(points, first)
        size_m = sides_m.max(axis=1)
        is_odd = np.array([_fault_of_words(element.attributes) is not None for element in some])
        is_odd |= (size_m > LARGEST_M) | (count * size_m > _LONGEST_LINE_M)
        yield from (start + np.flatnonzero(is_odd)).tolist()


def tell(faulty: Mapping[str, str], name: str) -> None:
    """Log what was left out of a map, element by element."""
    for key, fault in list(faulty.items())[:_MOST_TOLD]:
        _log.warning("map %s: element '%s' is left out: %s", name, key[:60], fault)
    if len(faulty) > _MOST_TOLD:
        _log.warning("map %s: and %d more elements like these", name, len(faulty) - _MOST_TOLD)
