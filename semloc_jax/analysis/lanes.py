"""The ways that a map's lanes make, where no path is given (room: analysis; host).

In: a SemanticMap. Out: Ways along the middle of its lanes, one place each some metres.
A walk starts between two lines that are a lane apart and continues while a line is beside it; gaps between dashes
do not end it. Maps seldom state the direction of travel: ways follow the direction in which their lines are stored.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from semloc_jax.analysis.survey import Way
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.polyline import arc_length
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.maps.curves import resample, without_repeats
from semloc_jax.structs import ElementClass

BESIDE = frozenset({ElementClass.LANE_MARKING, ElementClass.CURB})


@dataclass(frozen=True)
class LaneConfig:
    """What counts as a lane. All values are our choice."""

    min_width_m: float = 2.4
    max_width_m: float = 5.0
    gap_m: float = 15.0
    """A way ends where no line is beside it for this far."""
    stride_m: float = 1.0
    """Step of the walk."""
    apart_m: float = 1.2
    """Ways nearer than this are one."""
    min_length_m: float = 20.0
    """Shorter ways are left out."""


_LANE = LaneConfig()


def lane_ways(semantic_map: SemanticMap, spacing_m: float) -> tuple[Way, ...]:
    """The ways along the lanes of a map, longest first, with a place each `spacing_m`.

    Raises:
        SemlocError: the map has no two lines that are a lane apart, or the spacing is not positive.
    """
    if not spacing_m > 0:
        raise SemlocError(f"survey: spacing {spacing_m} m; expected a positive number such as 5")
    lines = _Lines.of(semantic_map.elements)
    walks: list[np.ndarray] = []
    for index in lines.seeds():
        direction = lines.direction[index]
        for start in lines.lanes_beside(lines.xy[index], direction):
            if _is_taken(walks, start, _LANE.apart_m):
                continue
            back, ahead = (_walk(lines, start, sign * direction, walks) for sign in (-1.0, 1.0))
            walk = np.concatenate([back[::-1], start[None], ahead])
            if _LANE.stride_m * (len(walk) - 1) >= _LANE.min_length_m:
                walks.append(walk)
    if not walks:
        raise SemlocError(
            f"map {semantic_map.name}: no two lines of paint or curbs are a lane apart, so no way can be found; "
            "give the way that is driven with --path FILE"
        )
    walks.sort(key=len, reverse=True)
    return tuple(_way(semantic_map, f"lane {k}", walk, spacing_m) for k, walk in enumerate(walks, start=1))


@dataclass(frozen=True)
class _Lines:
    """Points each metre of what lies beside lanes, with the direction of the line."""

    xy: np.ndarray
    direction: np.ndarray
    tree: cKDTree

    @classmethod
    def of(cls, elements: Sequence[MapElement]) -> "_Lines":
        found = [without_repeats(e.points) for e in elements if e.label in BESIDE and not e.closed]
        found = [np.column_stack([points[:, :2], np.zeros(len(points))]) for points in found if len(points) >= 2]
        if not found:
            return cls(np.zeros((0, 2)), np.zeros((0, 2)), cKDTree(np.zeros((1, 2))))
        position, tangent, *_ = resample(found, 1.0)
        return cls(position[:, :2], tangent[:, :2], cKDTree(position[:, :2]))

    def seeds(self) -> np.ndarray:
        """Points from which a walk may start: a few on each stretch of line."""
        return np.arange(0, len(self.xy), max(1, int(_LANE.min_length_m / 4)))

    def beside(
        self, at: np.ndarray, direction: np.ndarray, reach_m: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Offset to the left, offset ahead [m] and direction (turned along) of the parallel line points at a place."""
        if not len(self.xy):
            return np.zeros(0), np.zeros(0), np.zeros((0, 2))
        near = np.asarray(self.tree.query_ball_point(at, reach_m), dtype=int)
        cosine = self.direction[near] @ direction
        offset = self.xy[near] - at
        ahead = offset @ direction
        keep = (np.abs(cosine) > 0.95) & (np.abs(ahead) < 6.0)
        left = offset @ np.array([-direction[1], direction[0]])
        return left[keep], ahead[keep], (self.direction[near] * np.sign(cosine)[:, None])[keep]

    def lanes_beside(self, at: np.ndarray, direction: np.ndarray) -> list[np.ndarray]:
        """Middles of the lanes to the right and to the left of a line point."""
        left, *_ = self.beside(at, direction, _LANE.max_width_m + 3.0)
        normal, found = np.array([-direction[1], direction[0]]), []
        for side in (-1.0, 1.0):
            across = side * left
            across = across[across > 0.5]
            if len(across) and _LANE.min_width_m < (width := across.min()) < _LANE.max_width_m:
                found.append(at + 0.5 * side * width * normal)
        return found


def _walk(lines: _Lines, at: np.ndarray, direction: np.ndarray, walks: list[np.ndarray]) -> np.ndarray:
    """Middle of the lane from a place on, step by step, `[k 2]`, until its lines end or another way is met."""
    found, width_m, blind_m, last = [], 3.5, 0.0, 0
    while blind_m < _LANE.gap_m and len(found) < 100_000:
        at = at + _LANE.stride_m * direction
        left, ahead, along = lines.beside(at, direction, 0.5 * _LANE.max_width_m + 4.5)
        inner = (np.abs(left) < 0.5 * _LANE.max_width_m + 0.5) & (np.abs(left) > 0.4)
        if inner.any():
            blind_m = 0.0
            at, width_m = _centred(at, direction, left[inner], width_m)
            mean = along[inner].mean(axis=0)
            direction = direction + 0.3 * (mean / np.linalg.norm(mean) - direction)
            direction /= np.linalg.norm(direction)
        else:
            blind_m += _LANE.stride_m
        if _is_taken([*walks, np.array(found[:-20])], at, _LANE.apart_m):
            break
        found.append(at)
        if (inner & (np.abs(ahead) < _LANE.stride_m)).any():
            last = len(found)
    return np.array(found[:last]).reshape(-1, 2)


def _centred(at: np.ndarray, direction: np.ndarray, left: np.ndarray, width_m: float) -> tuple[np.ndarray, float]:
    """The place moved towards the middle of the lines beside it, and the width of the lane."""
    sides = [np.median(part) if len(part) else None for part in (left[left > 0], left[left < 0])]
    if sides[0] is not None and sides[1] is not None:
        width = float(sides[0] - sides[1])
        if _LANE.min_width_m < width < _LANE.max_width_m:
            width_m = width
        shift = 0.5 * (sides[0] + sides[1])
    else:
        shift = sides[0] - 0.5 * width_m if sides[0] is not None else sides[1] + 0.5 * width_m
    limit = 0.25 * _LANE.stride_m
    return at + np.clip(shift, -limit, limit) * np.array([-direction[1], direction[0]]), width_m


def _is_taken(walks: Sequence[np.ndarray], at: np.ndarray, apart_m: float) -> bool:
    return any(len(walk) and np.min(np.sum((walk - at) ** 2, axis=1)) < apart_m**2 for walk in walks)


def _way(semantic_map: SemanticMap, name: str, walk: np.ndarray, spacing_m: float) -> Way:
    along_m = arc_length(walk)
    station_m = np.arange(0.0, along_m[-1] + 1e-9, spacing_m)
    x, y = (np.interp(station_m, along_m, walk[:, axis]) for axis in range(2))
    ahead = [np.interp(station_m + 2.0, along_m, c) - np.interp(station_m - 2.0, along_m, c) for c in walk.T]
    heading = np.arctan2(ahead[1], ahead[0])
    poses = [semantic_map.road_pose(*place) for place in zip(x, y, heading, strict=True)]
    return Way(name, np.stack(poses), station_m)
