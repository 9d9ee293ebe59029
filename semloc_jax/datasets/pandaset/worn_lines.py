"""Lines of which only pieces are left (room: datasets; host).

In: LabelledPoints of lines and of the road. Out: TracedLine. Labels follow a worn line across its gaps: where a row of
short dashes is left of a double line, all of it is labelled as line. Paint throws more light back than the road does.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from semloc_jax.datasets.pandaset.reader import ROAD, LabelledPoints
from semloc_jax.datasets.pandaset.vectorize import CELLS_M, StrokeSizes, TracedLine, trace_lines

_CELL_M = 0.5
"""Side of the cells in which levels are the same."""
_ROAD_M, _PAINT_M = 2.0, 1.5
"""Around a cell levels of road and paint are taken from points so near."""
_PAINT_PERCENT = 95.0
_MIN_POINTS = 20
"""Fewer tell no level."""
_CONTRAST = 1.3
"""Ratio of both from which on they can be told apart."""
_DASH_M = 0.2
"""Points nearer to a dash than this are its own."""
_USUAL_WIDTH_M, _WIDTHS_M = 0.10, (0.08, 0.4)
"""Of paint whose points do not tell its width, and of any paint."""
_LEFT_OVER = StrokeSizes(min_points=30, min_dash_points=50, min_length_m=0.5)
"""Bare road around a piece says where it ends, however few its points are. What is shorter is a spot without a
direction."""


class Told(NamedTuple):
    """What the light says of points that are labelled as paint."""

    is_told: Bool[np.ndarray, " n"]
    """Whether paint and road can be told apart there."""
    is_bare: Bool[np.ndarray, " n"]
    """Which of these are darker than halfway from the road to the paint around."""


def trace_paint(points: LabelledPoints, class_id: int, sweeps: slice) -> list[TracedLine]:
    """Strokes of a class: short straight ones as they are labelled; of lines, where the light tells, what is left of
    their paint."""
    own, road = points.seen(class_id, sweeps), points.seen(ROAD, sweeps)
    dashes = [line for line in trace_lines(own.p_map) if len(line.points) == 2]
    told = Told(np.zeros(len(own.p_map), bool), np.zeros(len(own.p_map), bool))
    for sensor in np.unique(own.sensor):
        here, beside = own.sensor == sensor, road.sensor == sensor
        by_light = told_by_light(own.p_map[here], own.intensity[here], road.p_map[beside], road.intensity[beside])
        for column, part in zip(told, by_light, strict=True):
            column[here] = part
    is_left = ~_is_of(own.p_map, dashes)
    lines = trace_lines(own.p_map[is_left & ~told.is_told])
    bright = own.p_map[is_left & told.is_told & ~told.is_bare]
    paint = [_with_width(line, bright) for line in trace_lines(bright, _LEFT_OVER, CELLS_M[:1])]
    return [*dashes, *lines, *paint]


def told_by_light(
    p_map: Float[np.ndarray, "n 3"],
    intensity: Float[np.ndarray, " n"],
    p_road: Float[np.ndarray, "m 3"],
    road: Float[np.ndarray, " m"],
) -> Told:
    """Which points that are labelled as paint are bare road.

    Args:
        p_map: labelled points of one sensor [m].
        intensity: what they throw back, on the scale of the sensor.
        p_road: points of the road of the same sensor [m].
        road: what these throw back.
    """
    if not len(p_map):
        return Told(np.zeros(0, bool), np.zeros(0, bool))
    cells, own = np.unique(np.floor(p_map[:, :2] / _CELL_M).astype(int), axis=0, return_inverse=True)
    middles = (cells + 0.5) * _CELL_M
    of_road = _levels(p_road, road, middles, _ROAD_M, 50.0)
    of_paint = _levels(p_map, intensity, middles, _PAINT_M, _PAINT_PERCENT)
    # A level that is not known compares as false.
    is_told = (of_paint > _CONTRAST * of_road)[own.ravel()]
    return Told(is_told, is_told & (intensity < 0.5 * (of_road + of_paint)[own.ravel()]))


def _levels(
    p_map: np.ndarray, intensity: np.ndarray, middles: np.ndarray, reach_m: float, percent: float
) -> Float[np.ndarray, " k"]:
    """Percentile of what points near each place throw back; NaN where there are few."""
    if not len(p_map):
        return np.full(len(middles), np.nan)
    near = cKDTree(p_map[:, :2]).query_ball_point(middles, reach_m)
    return np.array([np.percentile(intensity[k], percent) if len(k) >= _MIN_POINTS else np.nan for k in near])


def _with_width(line: TracedLine, bright: np.ndarray) -> TracedLine:
    """A straight stroke with the width over which its paint would scatter as its points do; the mean of its length, as
    a bent one would be told too wide."""
    if len(line.points) != 2:
        return replace(line, width_m=_USUAL_WIDTH_M)
    near, across = _beside(line, bright)
    return replace(line, width_m=float(np.clip(np.sqrt(12.0) * np.std(across[near]), *_WIDTHS_M)))


def _is_of(p_map: np.ndarray, dashes: list[TracedLine]) -> Bool[np.ndarray, " n"]:
    """Which points belong to one of the dashes."""
    found = np.zeros(len(p_map), bool)
    for dash in dashes:
        found |= _beside(dash, p_map)[0]
    return found


def _beside(line: TracedLine, p_map: np.ndarray) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Which points are near a straight stroke, and how far to its left each is [m]."""
    start, end = line.points[0, :2], line.points[-1, :2]
    length_m = np.linalg.norm(end - start)
    axis, offset = (end - start) / length_m, p_map[:, :2] - start
    along, across = offset @ axis, offset @ [-axis[1], axis[0]]
    return (along > -_DASH_M) & (along < length_m + _DASH_M) & (np.abs(across) < _DASH_M), across
