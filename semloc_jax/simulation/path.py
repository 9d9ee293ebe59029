"""Curved lines in the plane by arc length, open and closed (room: simulation; host).

In: curvature along the line, or a random generator. Out: places and headings at distance s and lateral offset;
ClosedLine, the middle of a closed road with rounded corners and one long straight.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.polyline import arc_length


@dataclass(frozen=True)
class PlanePath:
    """Line sampled densely by arc length.

    Args:
        s_m: increasing arc length.
        xy: places in the map frame [m].
        heading_rad: direction of the tangent, continuous.
    """

    s_m: Float[np.ndarray, " n"]
    xy: Float[np.ndarray, "n 2"]
    heading_rad: Float[np.ndarray, " n"]

    def at(self, s_m: Float[np.ndarray, " k"], lateral_m: Float[np.ndarray, " k"] | float = 0.0) -> np.ndarray:
        """Places [k 2] at arc length `s_m`, `lateral_m` to the left."""
        heading = self.heading_at(s_m)
        left = np.column_stack([-np.sin(heading), np.cos(heading)])
        center = np.column_stack([np.interp(s_m, self.s_m, self.xy[:, axis]) for axis in range(2)])
        return center + np.asarray(lateral_m)[..., None] * left

    def heading_at(self, s_m: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Headings at arc length."""
        return np.interp(s_m, self.s_m, self.heading_rad)


def winding_path(
    rng: np.random.Generator, start_m: float, end_m: float, max_curvature: float = 0.006, start_heading_rad: float = 0.0
) -> PlanePath:
    """A seeded line whose curvature swings smoothly within +-`max_curvature` [1/m]; (0, 0) is at s = 0."""
    s = np.arange(start_m, end_m, 0.05)
    curvature = np.zeros_like(s)
    for length_m in (70.0, 160.0):
        curvature += 0.5 * max_curvature * np.sin(2.0 * np.pi * s / length_m + rng.uniform(0.0, 2.0 * np.pi))
    return path_from_curvature(s, curvature, start_heading_rad)


def path_from_curvature(s_m: np.ndarray, curvature: np.ndarray, start_heading_rad: float) -> PlanePath:
    """Integral of curvature [1/m] at `s_m`; place (0, 0) and `start_heading_rad` are at s = 0."""
    step = np.diff(s_m)
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * step)])
    heading += start_heading_rad - np.interp(0.0, s_m, heading)
    middle = 0.5 * (heading[1:] + heading[:-1])
    xy = np.vstack([np.zeros(2), np.cumsum(step[:, None] * np.column_stack([np.cos(middle), np.sin(middle)]), axis=0)])
    xy -= [np.interp(0.0, s_m, xy[:, 0]), np.interp(0.0, s_m, xy[:, 1])]
    return PlanePath(s_m, xy, heading)


_STEP_M = 0.1
_SMOOTH_M = 5.0
"""Curvature comes and goes over about this distance."""
_STRAIGHT_PER_M = 2e-4
_NUM_TRIES = 200
_APART_M = 70.0
"""Two stretches that are not neighbours along the line stay this far apart."""


@dataclass(frozen=True)
class ClosedLine:
    """A closed line by arc length from 0 to its length; counter-clockwise or clockwise.

    Args:
        xy: places 0.1 m apart, the first one not repeated [m].
        heading_rad: direction of the tangent, continuous.
        curvature: [1/m], positive to the left.
        straight_m: where its longest straight begins and ends.
    """

    xy: Float[np.ndarray, "n 2"]
    heading_rad: Float[np.ndarray, " n"]
    curvature: Float[np.ndarray, " n"]
    straight_m: tuple[float, float]

    @property
    def length_m(self) -> float:
        """Length of one lap."""
        step = np.linalg.norm(np.roll(self.xy, -1, axis=0) - self.xy, axis=1)
        return float(step.sum())

    def unrolled(self, from_m: float, to_m: float) -> PlanePath:
        """The line as a path that goes round as often as asked for."""
        length_m = self.length_m
        spacing_m = length_m / len(self.xy)
        number = np.arange(np.floor(from_m / spacing_m), np.ceil(to_m / spacing_m) + 1).astype(int)
        lap, place = np.divmod(number, len(self.xy))
        turn = 2.0 * np.pi * np.sign(self.curvature.sum())
        return PlanePath(number * spacing_m, self.xy[place], self.heading_rad[place] + lap * turn)


def closed_line(rng: np.random.Generator, straight_m: float) -> ClosedLine:
    """A seeded closed line with a straight of at least `straight_m`, somewhere in the plane.

    Raises:
        SemlocError: none was found, which is a matter of the wished straight.
    """
    for _ in range(_NUM_TRIES):
        corners = _corners(rng, straight_m)
        radius_m = float(rng.uniform(22.0, 38.0))
        ring = shapely.Polygon(corners)
        if not ring.is_valid:
            continue
        rounded = (
            ring.buffer(-radius_m, quad_segs=48).buffer(2.0 * radius_m, quad_segs=48).buffer(-radius_m, quad_segs=48)
        )
        if rounded.geom_type != "Polygon" or rounded.is_empty:
            continue
        found = _smoothed(np.array(rounded.exterior.coords)[:-1], rng)
        if found.straight_m[1] - found.straight_m[0] >= straight_m and not _comes_near_itself(found):
            return found
    raise SemlocError(f"no closed line with a straight of {straight_m:g} m was found; expected 150 to 350 m")


def _corners(rng: np.random.Generator, straight_m: float) -> np.ndarray:
    """A straight side, and corners on the other side of an oval."""
    base_m = straight_m + rng.uniform(40.0, 110.0)
    count = int(rng.integers(3, 6))
    half = np.array([0.5 * base_m + rng.uniform(10.0, 70.0), rng.uniform(80.0, 140.0)])
    angle = np.radians(np.linspace(rng.uniform(0.0, 15.0), rng.uniform(165.0, 180.0), count))
    angle[1:-1] += np.radians(rng.uniform(-10.0, 10.0, count - 2))
    radius = rng.uniform(0.85, 1.15, count)
    center = np.array([0.5 * base_m, rng.uniform(0.5, 0.9) * half[1]])
    others = center + radius[:, None] * half * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.vstack([[[0.0, 0.0], [base_m, 0.0]], others])


def _smoothed(outline: np.ndarray, rng: np.random.Generator) -> ClosedLine:
    """The line resampled and smoothed, turned and moved, in one of both directions."""
    if rng.random() < 0.5:
        outline = outline[::-1]
    turn = rng.uniform(-np.pi, np.pi)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    line = _evenly(outline - outline.mean(axis=0)) @ R.T
    line = _evenly(gaussian_filter1d(line, _SMOOTH_M / _STEP_M, axis=0, mode="wrap"))
    line = np.roll(line, -int(rng.integers(len(line))), axis=0)
    ahead = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0)
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    closing = np.angle(np.exp(1j * (heading[0] - heading[-1])))
    bend = np.diff(np.append(heading, heading[-1] + closing)) / _STEP_M
    curvature = gaussian_filter1d(bend, 1.0 / _STEP_M, mode="wrap")
    # The longest straight must not run over the end of the list: begin in the middle of the sharpest bend.
    first = int(np.argmax(np.abs(curvature)))
    line, heading, curvature = (np.roll(a, -first, axis=0) for a in (line, heading, curvature))
    return ClosedLine(line, np.unwrap(heading), curvature, _longest_straight(curvature))


def _longest_straight(curvature: np.ndarray) -> tuple[float, float]:
    edges = np.diff(np.concatenate([[0], np.abs(curvature) < _STRAIGHT_PER_M, [0]]).astype(int))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not len(begins):
        return 0.0, 0.0
    best = int(np.argmax(ends - begins))
    return float(begins[best] * _STEP_M), float(ends[best] * _STEP_M)


def _comes_near_itself(line: ClosedLine) -> bool:
    """Whether places far apart along the line lie close to each other."""
    places = line.xy[::50]
    s = np.arange(len(places)) * 50 * _STEP_M
    apart = np.abs(s[:, None] - s[None, :])
    apart = np.minimum(apart, line.length_m - apart)
    away = np.linalg.norm(places[:, None] - places[None, :], axis=2)
    return bool((away[apart > 2.5 * _APART_M] < _APART_M).any())


def _evenly(ring: np.ndarray) -> np.ndarray:
    """Places `_STEP_M` apart along a closed line."""
    closed = np.vstack([ring, ring[:1]])
    s = arc_length(closed)
    at = np.linspace(0.0, s[-1], round(s[-1] / _STEP_M), endpoint=False)
    return np.column_stack([np.interp(at, s, closed[:, axis]) for axis in range(2)])
