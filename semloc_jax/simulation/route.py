"""A way to drive on a real map: along its lanes, along its markings, or as given (room: simulation; host).

In: centre lines of lanes, map elements, where to drive. Out: PlanePath.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from semloc_jax.datasets.tables import read_columns
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import read_trajectory
from semloc_jax.geometry.polyline import arc_length
from semloc_jax.maps import MapElement
from semloc_jax.simulation.path import PlanePath
from semloc_jax.structs import ElementClass

_STEP_M = 0.5
_SMOOTH_M = 2.5
"""Corners of centre lines are rounded over this distance, as drivers do."""
_JOIN_M = 0.6
_JOIN_RAD = np.radians(50.0)
_MARK_JOIN_M = 15.0
"""Bars of one dashed line are at most this far apart."""
_MARK_JOIN_RAD = np.radians(15.0)
_FARTHEST_START_M = 20.0
_NUM_TRIES = 24
_SEEN_M = 30.0
_MUCH = 60
"""As many places to see within that distance are as good as more."""
_BESIDE_M = 1.75
"""Half a lane: how far right of a marking to drive where no lane is known."""
_LINES = (ElementClass.LANE_MARKING, ElementClass.CURB, ElementClass.GUARDRAIL)


@dataclass(frozen=True)
class RouteWish:
    """Where to drive on a map.

    Args:
        start_xy: place to start from in the map frame [m]; None lets the seed choose.
        heading_deg: direction to start in, counter-clockwise from x; None takes that of the lane.
        length_m: way to drive.
        path: TUM or csv file (columns x, y) with the way itself.
    """

    start_xy: tuple[float, float] | None = None
    heading_deg: float | None = None
    length_m: float = 150.0
    path: Path | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.length_m) and self.length_m > 0.0):
            raise SemlocError(f"length_m = {self.length_m:g}; expected metres to drive, more than 0")


def find_route(
    lanes: Sequence[np.ndarray], elements: Sequence[MapElement], wish: RouteWish, rng: np.random.Generator
) -> Float[np.ndarray, "n 2"]:
    """Places along the way, as long as wished where the map reaches that far.

    Args:
        lanes: centre lines `[k 3]` in the direction of travel; empty where the map knows none.
        elements: what can be seen; the way leads past much of it.
        wish: start, direction, length or the whole way.
        rng: chooses among starts.

    Raises:
        SemlocError: the start is off the map, or nothing to drive along.
    """
    if wish.path is not None:
        return _cut(_read_path(wish.path), wish.length_m)
    lanes = [np.asarray(lane)[:, :2] for lane in lanes] or _beside_markings(elements)
    if not lanes:
        raise SemlocError("the map has no lanes and no lines to drive along; give the way with --path FILE")
    if wish.start_xy is not None:
        first, begin = _nearest_lane(lanes, np.array(wish.start_xy), wish.heading_deg)
        return _follow(lanes, first, begin, wish.length_m)
    visible = _visible_places(elements)
    tries = rng.choice(len(lanes), size=min(_NUM_TRIES, len(lanes)), replace=False)
    routes = [_follow(lanes, int(number), 0.0, wish.length_m) for number in tries]
    return max(routes, key=lambda route: _score(route, visible, wish.length_m))


def drivable(route: Float[np.ndarray, "n 2"], margin_m: float) -> PlanePath:
    """A smooth line along the places of a route, from s = 0 on, with straight ends `margin_m` long."""
    route = _resampled(route, _STEP_M)
    ends = [_straight(route[:: 1 if at_end else -1], margin_m) for at_end in (False, True)]
    line = np.vstack([ends[0][::-1], route, ends[1]])
    line = gaussian_filter1d(line, _SMOOTH_M / _STEP_M, axis=0, mode="nearest")
    start_m = len(ends[0]) * _STEP_M
    fine = _resampled(line, 0.05)
    # A second, short smoothing: the curvature of straight chords would jump at every vertex.
    fine = gaussian_filter1d(fine, 0.5 / 0.05, axis=0, mode="nearest")
    step = np.diff(fine, axis=0)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(step, axis=1))])
    heading = np.unwrap(np.arctan2(*np.gradient(fine, axis=0).T[::-1]))
    return PlanePath(s - start_m, fine, heading)


def _straight(route: np.ndarray, length_m: float) -> np.ndarray:
    """Places straight ahead beyond the end of a route."""
    back = route[max(len(route) - 7, 0)]
    direction = (route[-1] - back) / np.linalg.norm(route[-1] - back)
    return route[-1] + np.arange(_STEP_M, length_m + _STEP_M, _STEP_M)[:, None] * direction


def _visible_places(elements: Sequence[MapElement]) -> cKDTree:
    """Places about 2 m apart on everything that can be seen."""
    lines = [element.points[:, :2] for element in elements if not element.is_logical]
    return cKDTree(np.vstack([np.zeros((0, 2)), *(_resampled(line, 2.0) for line in lines if len(line) > 1)]))


def _score(route: np.ndarray, visible: cKDTree, length_m: float) -> float:
    """How good a route is: as long as wished, with something to see everywhere beside it."""
    driven = float(np.linalg.norm(np.diff(route, axis=0), axis=1).sum())
    seen = visible.query_ball_point(route[::10], _SEEN_M, return_length=True)
    return driven / length_m + float(np.minimum(seen / _MUCH, 1.0).mean())


def _follow(lanes: Sequence[np.ndarray], number: int, begin_m: float, length_m: float) -> np.ndarray:
    """The lane from `begin_m` on and those after it, always the straightest, up to a length."""
    starts = np.array([lane[0] for lane in lanes])
    courses = np.array([_course(lane[:3]) for lane in lanes])
    lane = _resampled(lanes[number], _STEP_M)
    parts, driven, used = [lane[min(int(begin_m / _STEP_M), len(lane) - 2) :]], 0.0, {number}
    while True:
        driven += float(np.linalg.norm(np.diff(parts[-1], axis=0), axis=1).sum())
        if driven >= length_m:
            break
        end, course = parts[-1][-1], _course(parts[-1][-3:])
        turn = np.abs(np.angle(np.exp(1j * (courses - course))))
        fits = (np.linalg.norm(starts - end, axis=1) < _JOIN_M) & (turn < _JOIN_RAD)
        following = [int(k) for k in np.flatnonzero(fits) if int(k) not in used]
        if not following:
            break
        bend = [abs(np.angle(np.exp(1j * (_course(lanes[k][[0, -1]]) - course)))) for k in following]
        best = following[int(np.argmin(bend))]
        used.add(best)
        parts.append(_resampled(lanes[best], _STEP_M))
    return _cut(np.vstack([parts[0], *(part[1:] for part in parts[1:])]), length_m)


def _nearest_lane(lanes: Sequence[np.ndarray], start: np.ndarray, heading_deg: float | None) -> tuple[int, float]:
    """Which lane passes nearest to a place in about the wished direction, and the way along it [m]."""
    found = []
    for number, lane in enumerate(lanes):
        places = _resampled(lane, _STEP_M)
        away = np.linalg.norm(places - start, axis=1)
        nearest = int(np.argmin(away))
        if heading_deg is not None:
            here = _course(places[max(nearest - 1, 0) : nearest + 2])
            away[nearest] += 5.0 * abs(np.angle(np.exp(1j * (here - np.radians(heading_deg)))))
        # At the end of a lane its successor is equally near.
        found.append((away[nearest] + (1e-3 if nearest > len(places) - 4 else 0.0), number, nearest * _STEP_M))
    distance, number, begin_m = min(found)
    if distance > _FARTHEST_START_M:
        raise SemlocError(
            f"start ({start[0]:g}, {start[1]:g}) is {distance:.0f} m off the nearest lane; expected a place "
            f"within {_FARTHEST_START_M:.0f} m of one, in metres of the map frame: 'semloc inspect' shows its extent"
        )
    return number, begin_m


def _beside_markings(elements: Sequence[MapElement]) -> list[np.ndarray]:
    """Ways half a lane to the right of painted lines, curbs and rails; bars of a dashed line are joined."""
    lines = [e.points[:, :2] for e in elements if e.label in _LINES and not e.closed and e.length_m > 0.5]
    open_lines, joined = [_resampled(line, _STEP_M) for line in lines], []
    while open_lines:
        line = open_lines.pop(0)
        while (following := _next_bar(line, open_lines)) is not None:
            line = np.vstack([line, open_lines.pop(following)])
        joined.append(line)
    ways = []
    for line in joined:
        direction = np.gradient(line, axis=0)
        direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
        direction = gaussian_filter1d(direction, 4.0, axis=0, mode="nearest")
        right = np.column_stack([direction[:, 1], -direction[:, 0]])
        ways += [line + _BESIDE_M * right, (line - _BESIDE_M * right)[::-1]]
    return ways


def _next_bar(line: np.ndarray, others: Sequence[np.ndarray]) -> int | None:
    """Which of the other lines continues this one."""
    if not others:
        return None
    step = np.array([other[0] for other in others]) - line[-1]
    gap = np.linalg.norm(step, axis=1)
    course = _course(line[-5:])
    towards = np.abs(np.angle(np.exp(1j * (np.arctan2(step[:, 1], step[:, 0]) - course))))
    turn = np.abs(np.angle(np.exp(1j * (np.array([_course(other[:5]) for other in others]) - course))))
    fits = (gap < _MARK_JOIN_M) & (turn < _MARK_JOIN_RAD) & ((towards < _MARK_JOIN_RAD) | (gap < _JOIN_M))
    return int(np.argmin(np.where(fits, gap, np.inf))) if fits.any() else None


def _read_path(path: Path) -> np.ndarray:
    if not path.is_file():
        raise SemlocError(f"path {path}: no such file; expected a TUM trajectory or a csv with columns x, y")
    if path.suffix.lower() == ".csv":
        table = read_columns(path, ("x", "y"))
        places = np.column_stack([table["x"], table["y"]])
    else:
        places = read_trajectory(path).T_map_base[:, :2, 3]
    if not np.isfinite(places).all() or len(places) < 2 or np.ptp(places, axis=0).max() < 1.0:
        raise SemlocError(f"path {path}: {len(places)} places; expected two or more finite ones, metres apart")
    return places


def _course(places: np.ndarray) -> float:
    step = places[-1] - places[0]
    return float(np.arctan2(step[1], step[0]))


def _cut(places: np.ndarray, length_m: float) -> np.ndarray:
    """The first `length_m` of a line."""
    line = _resampled(places, _STEP_M)
    return line[: max(2, round(length_m / _STEP_M) + 1)]


def _resampled(places: np.ndarray, step_m: float) -> np.ndarray:
    """Places `step_m` apart along a line, its ends included."""
    s = arc_length(places)
    kept = np.concatenate([[True], np.diff(s) > 1e-9])
    s, places = s[kept], places[kept]
    if len(s) < 2:
        return places
    at = np.linspace(0.0, s[-1], max(2, round(s[-1] / step_m) + 1))
    return np.column_stack([np.interp(at, s, places[:, axis]) for axis in range(2)])
