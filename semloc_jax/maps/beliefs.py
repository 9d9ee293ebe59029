"""A map that knows how sure it is of every element (room: maps; host).

In: a SemanticMap and one Belief for each element. Out: BeliefMap, and a SemanticMap that carries the beliefs as
properties of its elements, so that GeoPackage and GeoJSON keep them without loss and every reader of maps opens them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.semantic_map import SemanticMap

MAP_SIGMA_M = 0.1
"""How far the elements of a map without beliefs are taken to be off; our choice, about what map makers promise."""

CERTAIN_LOGIT = 6.0
"""Existence of an element that somebody else's map states: 99.75 %; our choice."""

_LEAST_SIGMA_M = 1e-6
"""Below it the information of an element is no number any more; ours."""

_SHARED = ("sigma_place_m", "sigma_turn_rad")
_REQUIRED = ("sigma_across_m", "sigma_along_m", "existence_logit", "num_seen", "num_missed")


@dataclass(frozen=True)
class Belief:
    """How sure a map is of one element.

    Attributes:
        sigma_across_m: standard deviation across the element's longest side; of a post: of its foot, either way.
        sigma_along_m: standard deviation of its ends along the longest side.
        existence_logit: log odds that it is there.
        num_seen: frames that showed it.
        num_missed: frames that looked where it should be and did not show it.
        first_seen_s, last_seen_s: time of the drive; None where no drive saw it.
        provenance: what it was made from: the name of a drive, or of the map that stated it.
        sigma_place_m: standard deviation of the place of all that is around it, in either direction: an error that it
            shares with its neighbours, beside the two above.
        sigma_turn_rad: the same of their direction.
    """

    sigma_across_m: float
    sigma_along_m: float
    existence_logit: float
    num_seen: int = 0
    num_missed: int = 0
    first_seen_s: float | None = None
    last_seen_s: float | None = None
    provenance: str = ""
    sigma_place_m: float = 0.0
    sigma_turn_rad: float = 0.0

    def __post_init__(self) -> None:
        numbers = (self.sigma_across_m, self.sigma_along_m, self.existence_logit)
        times = [time_s for time_s in (self.first_seen_s, self.last_seen_s) if time_s is not None]
        shared = (self.sigma_place_m, self.sigma_turn_rad)
        is_finite = bool(np.isfinite([*numbers, *shared, *times]).all())
        least = min(self.num_seen, self.num_missed, *shared)
        if not is_finite or min(numbers[:2]) < _LEAST_SIGMA_M or least < 0:
            raise SemlocError(
                f"belief: sigmas {numbers[:2]} m, shared {shared} m, rad, existence {numbers[2]}, counts "
                f"{(self.num_seen, self.num_missed)}, times {times} s; expected finite numbers, sigmas of "
                f"{_LEAST_SIGMA_M:g} m or more, shared ones and counts of 0 or more"
            )

    @property
    def existence(self) -> float:
        """Probability that the element is there."""
        return 0.5 * (1.0 + math.tanh(0.5 * self.existence_logit))

    @property
    def information(self) -> np.ndarray:
        """Inverse covariance `float64[2 2]` along and across the element [1/m^2]."""
        return np.diag([self.sigma_along_m**-2, self.sigma_across_m**-2])


@dataclass(frozen=True)
class BeliefMap:
    """A semantic map and how sure it is of every element.

    Attributes:
        map: elements without the properties of their beliefs.
        beliefs: one for each element, by id.
    """

    map: SemanticMap
    beliefs: Mapping[str, Belief]

    def __post_init__(self) -> None:
        lost = [element.id for element in self.map.elements if element.id not in self.beliefs]
        if lost or len(self.beliefs) != len(self.map.elements):
            raise SemlocError(
                f"map {self.map.name}: {len(self.beliefs)} beliefs for {len(self.map.elements)} elements"
                f"{f', none for {lost[0][:60]!r}' if lost else ''}; expected one for each id"
            )

    @classmethod
    def of(cls, semantic_map: SemanticMap, map_sigma_m: float = MAP_SIGMA_M) -> "BeliefMap":
        """The beliefs in a map that was read; an element without any gets those of a map that somebody else made.

        Args:
            semantic_map: any map.
            map_sigma_m: how far elements without beliefs are taken to be off, one standard deviation.

        Raises:
            SemlocError: a belief holds numbers that cannot be meant.
        """
        beliefs: dict[str, Belief] = {}
        bare = []
        for element in semantic_map.walk():
            found = stated_belief(element)
            beliefs[element.id] = found or Belief(map_sigma_m, map_sigma_m, CERTAIN_LOGIT, provenance=semantic_map.name)
            left = {key: value for key, value in element.attributes.items() if key not in _KEYS}
            bare.append(replace(element, attributes=left) if found else element)
        return cls(semantic_map.with_elements(bare), beliefs)

    def as_map(self) -> SemanticMap:
        """The map with its beliefs as properties of the elements: what every writer takes."""
        return self.map.with_elements(
            replace(element, attributes={**element.attributes, **_properties(self.beliefs[element.id])})
            for element in self.map.elements
        )


_KEYS = tuple(field.name for field in fields(Belief))


def _properties(belief: Belief) -> dict[str, Any]:
    values = {key: getattr(belief, key) for key in _KEYS}
    return {key: value for key, value in values.items() if value is not None and (value or key not in _SHARED)}


def stated_belief(element: MapElement) -> Belief | None:
    """The belief in the properties of an element; None where there is none.

    Raises:
        SemlocError: it holds numbers that cannot be meant.
    """
    held = {key: element.attributes[key] for key in _KEYS if key in element.attributes}
    if not set(_REQUIRED) <= set(held):
        return None
    try:
        numbers = {key: float(held[key]) for key in _REQUIRED[:3]}
        numbers |= {key: float(held[key]) for key in _SHARED if held.get(key) is not None}
        counts = {key: int(held[key]) for key in _REQUIRED[3:]}
        times = {key: float(held[key]) for key in ("first_seen_s", "last_seen_s") if held.get(key) is not None}
        return Belief(**numbers, **counts, **times, provenance=str(held.get("provenance", "")))
    except (TypeError, ValueError, OverflowError, SemlocError) as error:  # a count may be infinite
        raise SemlocError(f"map element '{element.id[:60]}': its belief cannot be read ({error})") from error
