"""What is wrong in a map (room: maps; host).

In: Columns of a map. Out: Defects: repeated, doubled, empty, self-crossing, without sizes or heights, gaps, under
ground. All work goes over arrays: a map has 100,000 elements.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from semloc_jax.maps.columns import Columns
from semloc_jax.maps.elements import PAINT_CLASSES, UPRIGHT_CLASSES
from semloc_jax.structs import ElementClass

_ZERO_LENGTH_M = 1e-3
_SAME_PLACE_M = 0.05
_MOST_NEIGHBOURS = 8
_WIDEST_GAP_M = 0.5
"""Ends of two solid lines that face each other nearer than this were meant to meet."""
_LONGEST_STEP_M = 2000.0
_FACING_COS = 0.96
_GROUND_REACH_M = 10.0
_GROUND_SPACING_M = 2.0
_MOST_GROUND = 400_000
"""Points of the road that are held; in larger maps they lie farther apart, still within the reach."""
_UNDER_M = 0.3
_AT_ONCE = 5000
_WIDTH, _RADIUS, _HEIGHT = range(3)
_NEEDED_SIZE = {
    ElementClass.POLE: (_RADIUS, "radius"),
    ElementClass.CONE: (_RADIUS, "radius"),
    ElementClass.TRAFFIC_LIGHT: (_WIDTH, "width"),
    ElementClass.GUARDRAIL: (_HEIGHT, "height"),
    ElementClass.LANE_MARKING: (_WIDTH, "width"),
}


@dataclass(frozen=True)
class Defect:
    """One thing that is wrong: what, with which element, and the numbers."""

    kind: str
    element: str
    detail: str


def find_defects(columns: Columns, skipped: Mapping[str, int], faulty: Mapping[str, str]) -> Iterator[Defect]:
    """Yields everything that looks wrong in a map.

    Args:
        columns: of the map.
        skipped: what its reader left out, by class, with counts.
        faulty: what is wrong with each element that was left out, by id.
    """
    for name, count in skipped.items():
        yield Defect("unknown class", name, f"{count} left out")
    for name, fault in faulty.items():
        yield Defect("left out", name, fault)
    has_heights = bool(columns.has_height.any())
    yield from _of_single_elements(columns, has_heights)
    if len(columns) and not has_heights:
        yield Defect("missing heights", "all elements", "the map is taken as flat")
    yield from _duplicates(columns)
    yield from _gaps(columns)
    yield from _under_ground(columns)


def _of_single_elements(c: Columns, has_heights: bool) -> Iterator[Defect]:
    """Yields what is wrong with elements on their own, in the order of the map."""
    first: dict[str, int] = {}
    is_repeated = np.array([first.setdefault(name, row) != row for row, name in enumerate(c.ids)], dtype=bool)
    is_empty = c.length_m < _ZERO_LENGTH_M
    crosses = _crosses_itself(c, ~is_empty)
    jumps = c.longest_step_m > _LONGEST_STEP_M
    is_flat = ~c.has_height & has_heights
    lacks = _missing_sizes(c)
    is_wrong = is_repeated | is_empty | crosses | jumps | is_flat
    is_wrong[list(lacks)] = True
    for row in np.flatnonzero(is_wrong):
        name, label = c.ids[row], ElementClass(int(c.label[row])).name
        if is_repeated[row]:
            yield Defect("repeated id", name, label)
        if is_empty[row]:
            yield Defect("zero length", name, f"{c.count[row]} points, {c.length_m[row] * 1000:.3f} mm")
        if crosses[row]:
            yield Defect("crosses itself", name, f"{label}, {c.count[row]} points")
        if jumps[row]:
            yield Defect("jump", name, f"{c.longest_step_m[row] / 1000.0:.1f} km from one vertex to the next")
        if is_flat[row]:
            yield Defect("missing heights", name, "taken from the road around it")
        if row in lacks:
            yield Defect("missing size", name, lacks[row])


def _missing_sizes(c: Columns) -> dict[int, str]:
    found = {}
    for label, (column, word) in _NEEDED_SIZE.items():
        rows = (c.label == int(label)) & ~c.closed & ~c.is_logical & (c.sizes_m[:, column] == 0.0)
        found |= dict.fromkeys(np.flatnonzero(rows).tolist(), f"{label.name} without {word}; its middle is sampled")
    rows = (c.label == int(ElementClass.PILLAR)) & (c.sizes_m[:, _HEIGHT] == 0.0)
    return found | dict.fromkeys(np.flatnonzero(rows).tolist(), "PILLAR without height; it is not sampled")


def _crosses_itself(c: Columns, asked: np.ndarray) -> np.ndarray:
    """Whether each line or area crosses itself seen from above (upright things always do), `bool[n]`."""
    found = np.zeros(len(c), dtype=bool)
    rows = np.flatnonzero(asked & (c.count > 2) & ~c.has_label({*UPRIGHT_CLASSES, ElementClass.SIGN}))
    for begin in range(0, len(rows), _AT_ONCE):
        some = rows[begin : begin + _AT_ONCE]
        points, whose = c.rings(some)
        found[some] = ~shapely.is_simple(shapely.linestrings(points[:, :2], indices=whose))
    return found


def _duplicates(c: Columns) -> Iterator[Defect]:
    """Yields each element that has the middle and the length of an earlier one of its class, with that one."""
    if len(c) < 2:
        return
    rows = np.column_stack([c.middle, c.length_m])
    most = min(_MOST_NEIGHBOURS, len(c))
    _, near = cKDTree(rows).query(rows, k=most, distance_upper_bound=_SAME_PLACE_M)
    is_there = near < np.arange(len(c))[:, None]
    near = np.where(is_there, near, 0)
    like = is_there & (c.label[near] == c.label[:, None]) & (c.is_logical[near] == c.is_logical[:, None])
    for other in np.flatnonzero(like.any(axis=1)):
        one = int(near[other][like[other]].min())
        gap_mm = 1000 * float(np.linalg.norm(rows[one, :3] - rows[other, :3]))
        yield Defect("duplicate", c.ids[other], f"{gap_mm:.0f} mm from {c.ids[one]}")


def _gaps(c: Columns) -> Iterator[Defect]:
    """Yields pairs of solid lines of one class and width whose ends face each other and do not meet."""
    lines = np.flatnonzero(c.is_solid & ~c.closed & (c.count > 1) & (c.length_m > 1.0))
    if not len(lines):
        return
    first, last = c.start[lines], c.start[lines + 1] - 1
    ends = c.points[np.stack([first, last], axis=1).ravel()]
    outward = ends - c.points[np.stack([first + 1, last - 1], axis=1).ravel()]
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    free = np.flatnonzero(cKDTree(ends).query_ball_point(ends, _SAME_PLACE_M, return_length=True) == 1)
    pairs = free[cKDTree(ends[free]).query_pairs(_WIDEST_GAP_M, output_type="ndarray")].reshape(-1, 2)
    for one, other in pairs[np.lexsort(pairs.T[::-1])]:
        a, b = lines[one // 2], lines[other // 2]
        if a == b or c.label[a] != c.label[b] or c.sizes_m[a, _WIDTH] != c.sizes_m[b, _WIDTH]:
            continue
        step = ends[other] - ends[one]
        gap_m = float(np.linalg.norm(step))
        if outward[one] @ outward[other] < -_FACING_COS and step @ outward[one] > _FACING_COS * gap_m:
            yield Defect("gap", c.ids[a], f"{100.0 * gap_m:.0f} cm to {c.ids[b]}")


def _under_ground(c: Columns) -> Iterator[Defect]:
    """Yields upright things that lie wholly below all road within 10 m."""
    classes = {*UPRIGHT_CLASSES, ElementClass.SIGN, ElementClass.PILLAR}
    upright = np.flatnonzero(c.has_height & c.has_label(classes))
    ground = _surface(c)
    if not len(upright) or not len(ground):
        return
    tree = cKDTree(ground[:, :2])
    height_m = np.where(c.label == int(ElementClass.PILLAR), c.sizes_m[:, _HEIGHT], 0.0)
    top = np.maximum.reduceat(c.points[:, 2], c.start[:-1]) + height_m
    for begin in range(0, len(upright), _AT_ONCE):
        some = upright[begin : begin + _AT_ONCE]
        near = tree.query_ball_point(c.points[c.start[some], :2], _GROUND_REACH_M)
        for row, rows in zip(some, near, strict=True):
            below_m = float(ground[rows, 2].min()) - top[row] if rows else 0.0
            if below_m > _UNDER_M:
                label = ElementClass(int(c.label[row])).name
                yield Defect("under ground", c.ids[row], f"{label}, {below_m:.1f} m below the road")


def _surface(c: Columns) -> np.ndarray:
    """Points of the road, one every 2 m along paint, curbs and slots with heights, `float64[q 3]`."""
    labels = {*PAINT_CLASSES, ElementClass.CURB, ElementClass.PARKING_SLOT}
    rows = np.flatnonzero(c.has_height & c.has_label(labels))
    spacing_m = max(_GROUND_SPACING_M, float(c.length_m[rows].sum()) / _MOST_GROUND)
    blocks = [_along(c, rows[k : k + _AT_ONCE], spacing_m) for k in range(0, len(rows), _AT_ONCE)]
    return np.concatenate([np.zeros((0, 3)), *blocks])


def _along(c: Columns, rows: np.ndarray, spacing_m: float) -> np.ndarray:
    """Points along some elements, `float64[q 3]`."""
    points, whose = c.rings(rows)
    step = np.diff(points, axis=0)
    step[np.diff(whose) != 0] = 0.0
    num = np.floor(np.linalg.norm(step[:, :2], axis=1) / spacing_m).astype(np.int64) + 1
    segment = np.repeat(np.arange(len(step)), num)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(num) - num, num)) / num[segment]
    return np.concatenate([points[:-1][segment] + share[:, None] * step[segment], points[-1:]])
