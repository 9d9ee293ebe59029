"""Paint that something crosses, in one piece again (room: mapping; host).

In: elements that a drive saw, with beliefs. Out: the same, pieces of one bar or dash as one. A trench, a crack or a
line across a bar leaves two pieces in line, closer together than paint of one kind ever is.
"""

from dataclasses import replace

import numpy as np

from semloc_jax.evaluation.map_shapes import Thing, kind_of, thing_of
from semloc_jax.maps import Belief, MapElement

_GAP_M = {"crosswalk": 0.8, "dash": 0.5, "stop_line": 3.5}
"""Farther apart, pieces of these kinds are two things. Bars lie side by side, never end to end; of a stop line a car or
a lane that nobody saw may be missing."""
_OVERLAP_M, _ASIDE_M = 0.1, 0.15
_TURN = np.cos(0.15)
"""Pieces whose directions differ by more are not in line; ours, as the lengths above."""


def rejoined(known: list[tuple[MapElement, Belief]]) -> list[tuple[MapElement, Belief]]:
    """Elements with beliefs; of pieces in line, the longest stands for all of them."""
    found = [item for item in known if kind_of(item[0]) not in _GAP_M]
    for kind, gap_m in _GAP_M.items():
        rest = [(thing_of(element), element, belief) for element, belief in known if kind_of(element) == kind]
        rest.sort(key=lambda item: -float(np.ptp(item[0].corners @ item[0].along)))
        while rest:
            thing, element, belief = rest.pop(0)
            while (
                row := next((k for k, (other, *_) in enumerate(rest) if _in_line(thing, other, gap_m)), None)
            ) is not None:
                element = _reaching(element, thing, rest.pop(row)[0])
                thing = thing_of(element)
            found.append((element, belief))
    return found


def _extent(thing: Thing, axis: np.ndarray) -> tuple[float, float]:
    side = thing.corners @ axis
    return float(side.min()), float(side.max())


def _in_line(long: Thing, other: Thing, gap_m: float) -> bool:
    """Whether something short goes on where something longer ends."""
    aside = np.array([-long.along[1], long.along[0]])
    if abs(float((other.centre - long.centre) @ aside)) > _ASIDE_M or abs(float(other.along @ long.along)) < _TURN:
        return False
    (a, b), (c, d) = _extent(long, long.along), _extent(other, long.along)
    return -_OVERLAP_M < max(c - b, a - d) < gap_m


def _reaching(element: MapElement, long: Thing, other: Thing) -> MapElement:
    """The longer one, stretched as far as the other reaches."""
    (a, b), (c, d) = _extent(long, long.along), _extent(other, long.along)
    side = element.points[:, :2] @ long.along
    stretched = min(a, c) + (side - a) * (max(b, d) - min(a, c)) / max(b - a, 1e-3)
    points = element.points.copy()
    points[:, :2] += (stretched - side)[:, None] * long.along
    return replace(element, points=points)
