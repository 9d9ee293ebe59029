"""What is painted on a random street, and what only looks like it (room: simulation; host).

In: a random generator, the line of the street. Out: shapes with the ids of their classes.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import shapely

from semloc_jax.simulation.elements import ARROW
from semloc_jax.simulation.looks.materials import (
    BLUE,
    DARK_PATCH,
    GHOST,
    GRAVEL,
    HOLE,
    LIGHT_PATCH,
    ORANGE,
    RED,
    TAR,
    WHITE,
    YELLOW,
    variant_id,
)
from semloc_jax.simulation.path import PlanePath

Mark = tuple[shapely.Geometry, int]
_STEP_M = 1.0
_TURN = np.array(
    [(-2.5, -0.08), (1.0, -0.08), (1.4, 0.5), (1.1, 0.7), (2.0, 1.2), (2.2, 0.1), (1.9, 0.3), (1.2, 0.08), (-2.5, 0.08)]
)


class CrossSection(NamedTuple):
    """The cross-section of a street; d [m] to the left of the middle of the own lane."""

    borders: tuple[float, ...]
    """From right to left."""
    center: int
    """Which of them parts the directions; -1 for a one-way street."""
    start_m: float
    end_m: float

    @property
    def lane_middles(self) -> list[float]:
        """Middles of the lanes from right to left."""
        return [0.5 * (a + b) for a, b in zip(self.borders[:-1], self.borders[1:], strict=True)]


def random_cross_section(rng: np.random.Generator, start_m: float, end_m: float) -> CrossSection:
    """CrossSection to the right and left of the own one."""
    width = rng.uniform(2.6, 3.9)
    right, left, oncoming = (
        int(rng.choice(3, p=(0.6, 0.3, 0.1))),
        int(rng.choice(3, p=(0.6, 0.3, 0.1))),
        int(rng.integers(0, 3)),
    )
    borders = width * (np.arange(-right, left + oncoming + 2) - 0.5)
    center = right + left + 1 if oncoming else -1
    return CrossSection(tuple(borders.tolist()), center, start_m, end_m)


def lane_marks(path: PlanePath, lanes: CrossSection, rng: np.random.Generator) -> list[Mark]:
    """Edge lines, dashes, centre lines."""
    dash_m, gap_m = [(3.0, 6.0), (4.0, 8.0), (6.0, 12.0), (3.0, 9.0), (1.5, 3.0), (3.0, 4.5), (6.0, 9.0)][
        int(rng.integers(7))
    ]
    width, center_paint = rng.uniform(0.08, 0.22), YELLOW if rng.random() < 0.45 else WHITE
    edge_paint, edge_width = YELLOW if rng.random() < 0.2 else WHITE, rng.uniform(0.08, 0.32)
    marks: list[Mark] = []
    for number, d in enumerate(lanes.borders):
        is_edge = number in (0, len(lanes.borders) - 1)
        if is_edge and rng.random() < 0.75:
            marks += _line(path, lanes, d, edge_width, variant_id("lane_solid", edge_paint))
        elif is_edge and rng.random() < 0.4:
            marks += _dashes(path, lanes, d, edge_width, (1.0, 1.0), variant_id("lane_dashed", edge_paint), rng)
        elif not is_edge and number == lanes.center:
            marks += _center(path, lanes, d, width, (dash_m, gap_m), center_paint, rng)
        elif not is_edge and rng.random() < 0.92:
            marks += _dashes(path, lanes, d, width, (dash_m, gap_m), variant_id("lane_dashed", WHITE), rng)
        elif not is_edge:
            marks += _line(path, lanes, d, width, variant_id("lane_solid", ORANGE if rng.random() < 0.3 else WHITE))
    return marks


def _center(
    path: PlanePath,
    lanes: CrossSection,
    d: float,
    width: float,
    rhythm: tuple[float, float],
    paint: int,
    rng: np.random.Generator,
) -> list[Mark]:
    solid, dashed = variant_id("lane_solid", paint), variant_id("lane_dashed", paint)
    kind, apart = int(rng.integers(4)), width + rng.uniform(0.06, 0.3)
    if kind == 0:
        return [*_line(path, lanes, d - 0.5 * apart, width, solid), *_line(path, lanes, d + 0.5 * apart, width, solid)]
    if kind == 1:
        return _line(path, lanes, d, width, solid)
    if kind == 2:
        beside = _dashes(path, lanes, d + 0.5 * apart, width, rhythm, dashed, rng)
        return [*_line(path, lanes, d - 0.5 * apart, width, solid), *beside]
    return _dashes(path, lanes, d, width, rhythm, dashed, rng)


def ribbon(path: PlanePath, from_m: float, to_m: float, d_m: float, width_m: float) -> shapely.Polygon:
    """A strip along the street."""
    s = np.linspace(from_m, to_m, max(2, int((to_m - from_m) / _STEP_M) + 1))
    return shapely.Polygon(np.vstack([path.at(s, d_m - 0.5 * width_m), path.at(s, d_m + 0.5 * width_m)[::-1]]))


def _line(path: PlanePath, lanes: CrossSection, d: float, width: float, kind: int) -> list[Mark]:
    return [(ribbon(path, lanes.start_m, lanes.end_m, d, width), kind)]


def _dashes(
    path: PlanePath,
    lanes: CrossSection,
    d: float,
    width: float,
    rhythm: tuple[float, float],
    kind: int,
    rng: np.random.Generator,
) -> list[Mark]:
    starts = np.arange(lanes.start_m + rng.uniform(0.0, sum(rhythm)), lanes.end_m, sum(rhythm))
    return [(ribbon(path, s, s + rhythm[0], d, width), kind) for s in starts.tolist()]


def _placed(path: PlanePath, shape: np.ndarray, s: float, d: float, turned: bool) -> shapely.Polygon:
    sign = -1.0 if turned else 1.0
    return shapely.Polygon(path.at(s + sign * shape[:, 0], d + sign * shape[:, 1]))


def junction_marks(path: PlanePath, lanes: CrossSection, s: float, rng: np.random.Generator) -> list[Mark]:
    """Stop line or teeth, crosswalk, arrows before them, words and signs on the road."""
    right, left = lanes.borders[0] + 0.2, lanes.borders[-1] - 0.2
    own_left = lanes.borders[lanes.center] if lanes.center > 0 else left
    marks: list[Mark] = []
    if rng.random() < 0.7:
        marks.append(
            (
                ribbon(path, s, s + rng.uniform(0.25, 0.6), 0.5 * (right + own_left), own_left - right),
                variant_id("stop_line", WHITE),
            )
        )
    elif rng.random() < 0.5:
        for d in np.arange(right, own_left, 0.9):
            teeth = np.array([(0.0, d), (0.0, d + 0.5), (-0.7, d + 0.25)])
            marks.append((shapely.Polygon(path.at(s + teeth[:, 0], teeth[:, 1])), variant_id("stop_line", WHITE)))
    if rng.random() < 0.7:
        begin, deep, pitch = s + rng.uniform(1.2, 3.0), rng.uniform(2.0, 4.5), rng.uniform(0.8, 1.2)
        paint = variant_id("crosswalk", YELLOW if rng.random() < 0.15 else WHITE)
        for d in np.arange(right + 0.2, left, pitch):
            marks.append((ribbon(path, begin, begin + deep, d + 0.25 * pitch, 0.5 * pitch), paint))
    for d in lanes.lane_middles:
        is_oncoming = lanes.center > 0 and d > own_left
        for back_m in (rng.uniform(4.0, 9.0), rng.uniform(14.0, 25.0)):
            if rng.random() < 0.6:
                shape = (ARROW, _TURN, _TURN * [1.0, -1.0])[int(rng.integers(3))] * rng.uniform(0.7, 1.3)
                marks.append((_placed(path, shape, s - back_m, d, is_oncoming), variant_id("arrow", WHITE)))
        if rng.random() < 0.35:
            marks += strokes(path, s - rng.uniform(28.0, 34.0), d - 0.7, 2.4, rng)
    return marks


def strokes(path: PlanePath, s: float, d: float, high_m: float, rng: np.random.Generator) -> list[Mark]:
    """Strokes as letters, numbers and symbols on the ground have them, from (s, d) on; `high_m` along the path."""
    kind = variant_id("arrow", (WHITE, WHITE, YELLOW, BLUE, RED)[int(rng.integers(5))])
    marks: list[Mark] = []
    for column in range(int(rng.integers(1, 5))):
        for _ in range(int(rng.integers(2, 5))):
            a = np.array([rng.uniform(0.0, high_m), 0.45 * column + rng.uniform(0.0, 0.35)])
            b = np.array([a[0], a[1] + 0.35]) if rng.random() < 0.5 else np.array([rng.uniform(0.0, high_m), a[1]])
            line = shapely.LineString(path.at(s + np.array([a[0], b[0]]), d + np.array([a[1], b[1]])))
            if line.length > 0.1:
                marks.append((line.buffer(rng.uniform(0.05, 0.09), cap_style="square"), kind))
    return marks


def hatched(path: PlanePath, lanes: CrossSection, rng: np.random.Generator) -> list[Mark]:
    """Slanted bars where nobody may drive, beside the right edge or between the directions."""
    d, wide = (lanes.borders[-1], 1.8) if rng.random() < 0.5 else (lanes.borders[0] - 1.8, 1.8)
    kind, begin = variant_id("arrow", WHITE), rng.uniform(lanes.start_m, lanes.end_m - 25.0)
    bars = [
        np.array([(s, d), (s + 0.6, d), (s + 2.4, d + wide), (s + 1.8, d + wide)])
        for s in np.arange(begin, begin + 22.0, 2.6)
    ]
    return [(shapely.Polygon(path.at(bar[:, 0], bar[:, 1])), kind) for bar in bars]


def decoys(path: PlanePath, lanes: CrossSection, rng: np.random.Generator) -> Iterator[Mark]:
    """What lies on the road and is no paint: patches, sealed cracks, old lines that were removed, lids, joints."""
    low, high, begin, end = lanes.borders[0] - 0.5, lanes.borders[-1] + 0.5, lanes.start_m, lanes.end_m
    for _ in range(int(rng.integers(0, 9))):
        s, d = rng.uniform(begin, end), rng.uniform(low, high)
        kind = (DARK_PATCH, LIGHT_PATCH, GRAVEL)[int(rng.choice(3, p=(0.55, 0.35, 0.1)))]
        yield ribbon(path, s, s + rng.uniform(0.5, 25.0), d, rng.uniform(0.4, 3.0)), variant_id("road", kind)
    for _ in range(int(rng.integers(0, 8))):
        s, steps = rng.uniform(begin, end), int(rng.integers(3, 12))
        walk = np.cumsum(rng.normal(0.0, 0.5, (steps, 2)) * [2.0, 1.0], axis=0) + [s, rng.uniform(low, high)]
        crack = shapely.LineString(path.at(walk[:, 0], np.clip(walk[:, 1], low, high)))
        yield crack.buffer(rng.uniform(0.015, 0.06)), variant_id("road", TAR)
    for _ in range(int(rng.integers(0, 4))):
        s = rng.uniform(begin, end)
        kind = variant_id("road", (TAR, GHOST, GHOST)[int(rng.integers(3))])
        yield ribbon(path, s, s + rng.uniform(1.0, 40.0), rng.uniform(low, high), rng.uniform(0.02, 0.2)), kind
    for _ in range(int(rng.integers(0, 5))):
        center = path.at(np.array([rng.uniform(begin, end)]), rng.uniform(low, high))[0]
        yield shapely.Point(center).buffer(rng.uniform(0.25, 0.4)), variant_id("road", HOLE)
    for s in np.arange(begin, end, rng.uniform(4.0, 15.0)) if rng.random() < 0.2 else ():
        yield ribbon(path, s, s + 0.03, 0.5 * (low + high), high - low), variant_id("road", TAR)
