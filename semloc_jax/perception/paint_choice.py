"""Which strokes of a top view are paint on a road (room: perception; host).

In: Strokes, the top view with its colours. Out: those that are paint, by contrast, colour, direction and company.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from semloc_jax.perception.paint_colours import TopView, is_no_grass, is_white_or_yellow
from semloc_jax.perception.paint_profiles import MIN_CONTRAST, RidgeProfiles
from semloc_jax.perception.paint_strokes import SEAM, Stroke
from semloc_jax.perception.point_groups import PointGroups

_FLANK_M = 0.12
_SOFT_M, _SOFT_PX = 0.06, 1.0
"""Edges of paint are as sharp as the picture; those of shade are softer by the width of the sun."""
_MIN_WIDTH_PX = 1.5
"""A bar across the view that is no wider in the image may be anything that is bright."""
_IN_LINE_RAD, _SEAM_RAD = np.deg2rad(2.0), np.deg2rad(6.0)
"""Turn of a stroke that continues another; what is faint is short, and its direction is not as sure."""
_RADIAL_RAD = 0.1
"""What stands is smeared along its ray."""


@dataclass(frozen=True)
class StrokeLimits:
    """What a stroke of paint is like."""

    min_length_m: float
    min_length_px: float
    """In pixels of the image along the stroke: far away all that stands or is lit is smeared into a stroke."""
    max_scatter_m: float
    """Root mean square of the ridge's distance from a smooth curve."""
    max_width_scatter: float
    """Median deviation of the width, as a share of the width."""
    min_contrast: float
    """Median contrast of the weaker side, in log brightness."""
    grey_sides: int
    """On how many sides the ground must have no colour of grass."""
    max_width_m: float
    thin_length_m: float
    """Least length of strokes thinner than `_THIN_M`."""


_THIN_M = 0.25
ALONG = StrokeLimits(1.2, 2.0, 0.03, 0.25, 0.2, 1, 0.52, 0.0)
"""Strokes that run with the road."""
ACROSS = StrokeLimits(1.2, 4.0, 0.02, 0.12, 0.3, 2, 0.72, 3.0)
"""Strokes of any direction: stop lines, crosswalks, arrows. Thin ones are lines of a crossing road or of a parking
slot, which are long; specks of sun are not."""
CONTINUED = StrokeLimits(0.6, 1.0, 0.03, 0.3, 0.12, 1, 0.52, 0.0)
"""Strokes in line with one that is paint."""


_LIMITS = ALONG, ACROSS, CONTINUED
MAX_SCATTER_M = max(limits.max_scatter_m for limits in _LIMITS)
"""Ridges with more are no paint whatever else they are."""


@dataclass(frozen=True)
class _Numbers:
    """What decides about strokes, all arrays [n]; the names of Stroke mean the same here."""

    length_m: np.ndarray
    scatter_m: np.ndarray
    width_scatter: np.ndarray
    contrast: np.ndarray
    width_m: np.ndarray
    rise_m: np.ndarray
    middle: np.ndarray
    """float[n 2]."""
    angle: np.ndarray
    """Direction from the first to the last point in the top view [rad]."""
    across_px_m: np.ndarray
    """Metres in one pixel of the image across the stroke."""
    along_px_m: np.ndarray

    @classmethod
    def of(cls, strokes: Sequence[Stroke], view: TopView) -> "_Numbers":
        """The numbers of at least one stroke."""
        names = ("length_m", "scatter_m", "width_scatter", "contrast", "width_m", "rise_m", "middle")
        own = {name: np.array([getattr(stroke, name) for stroke in strokes]) for name in names}
        step = np.array([stroke.uv[-1] - stroke.uv[0] for stroke in strokes])
        across = np.array([stroke.normal[len(stroke.normal) // 2] for stroke in strokes])
        along = np.stack([-across[:, 1], across[:, 0]], axis=-1)
        sizes = (view.pixel_m(own["middle"], direction).astype(np.float64) for direction in (across, along))
        return cls(*own.values(), np.arctan2(step[:, 1], step[:, 0]), *sizes)

    def have_shape(self, limits: StrokeLimits) -> np.ndarray:
        """Which strokes keep the limits in all but colour, bool[n]."""
        wide = np.where(self.across_px_m > self.along_px_m, _MIN_WIDTH_PX * self.across_px_m, 0.0)
        least_m = np.where(self.width_m < _THIN_M, limits.thin_length_m, limits.min_length_m)
        return (
            (
                self.length_m
                >= np.maximum(np.maximum(least_m, limits.min_length_m), limits.min_length_px * self.along_px_m)
            )
            & (self.scatter_m <= limits.max_scatter_m)
            & (self.width_scatter <= limits.max_width_scatter)
            & (self.contrast >= limits.min_contrast)
            & (self.width_m > np.maximum(0.06, wide))
            & (self.width_m < limits.max_width_m)
            & (self.rise_m < _SOFT_M + _SOFT_PX * self.across_px_m)
        )


def are_sharp(ridges: RidgeProfiles, view: TopView) -> np.ndarray:
    """Which points of ridges have two edges as sharp as those of paint, bool[n]."""
    allowed_m = _SOFT_M + _SOFT_PX * view.pixel_m(ridges.uv, ridges.normal)
    return (ridges.contrast > MIN_CONTRAST) & (ridges.width_m > 0.05) & (ridges.rise_m < allowed_m)


def choose_paint(strokes: Sequence[Stroke], view: TopView) -> list[Stroke]:
    """The strokes that are paint.

    Strokes in the direction of the road need less contrast than others, and those that continue a stroke need least.

    Args:
        strokes: from `find_strokes`.
        view: the top view.
    """
    if not strokes:
        return []
    numbers = _Numbers.of(strokes, view)
    along, across, continued = _passing(strokes, numbers, view)
    ray = numbers.middle - view.foot_uv
    distance_m = np.linalg.norm(ray, axis=-1) * view.metres_per_px
    radial = _turn(numbers.angle, np.arctan2(ray[:, 1], ray[:, 0])) < _RADIAL_RAD
    chosen = across & ~radial
    direction = _road_direction(numbers, distance_m, along, radial)
    if direction is not None:
        chosen |= along & (_turn(numbers.angle, direction) < _tolerance_rad(distance_m))
    rest = np.flatnonzero(~chosen & continued)
    first = np.flatnonzero(chosen)
    found = rest[_continue(numbers, rest, first, view.metres_per_px).any(axis=1)]
    kept = np.append(first, found).astype(int)
    return [strokes[i] for i in kept[~_are_seams(numbers, kept, view.metres_per_px)]]


def _passing(strokes: Sequence[Stroke], numbers: _Numbers, view: TopView) -> list[np.ndarray]:
    """Which strokes keep each of the limits, bool[n] each; colours are looked at where the shape is right."""
    shaped = [numbers.have_shape(limits) for limits in _LIMITS]
    grey_sides = np.zeros(len(strokes), int)
    looked_at = np.flatnonzero(np.any(shaped, axis=0))
    if len(looked_at):
        grey_sides[looked_at] = _grey_sides([strokes[i] for i in looked_at], view)
    return [shape & (grey_sides >= limits.grey_sides) for shape, limits in zip(shaped, _LIMITS, strict=True)]


def _grey_sides(strokes: Sequence[Stroke], view: TopView) -> np.ndarray:
    """Number of sides without grass, int[n]; 0 for a stroke that is neither white nor yellow."""
    groups = PointGroups([int(stroke.painted.sum()) for stroke in strokes])
    uv = np.concatenate([stroke.uv[stroke.painted] for stroke in strokes])
    beside = np.concatenate(
        [stroke.normal[stroke.painted] * ((0.5 * stroke.width_m + _FLANK_M) / view.metres_per_px) for stroke in strokes]
    )
    middle, *sides = (groups.mean(view.colours(uv + side * beside).T).T for side in (0.0, -1.0, 1.0))
    return np.where(is_white_or_yellow(middle), np.sum([is_no_grass(side) for side in sides], axis=0), 0)


def _road_direction(numbers: _Numbers, distance_m: np.ndarray, along: np.ndarray, radial: np.ndarray) -> float | None:
    """Direction [rad] in the top view that most of some strokes share, near ones most; None where there are too few.

    Strokes along their own ray have no say where others agree: trunks in the sun all run as the camera looks at them.
    """
    for of in (np.flatnonzero(along & ~radial), np.flatnonzero(along)):
        if not len(of):
            continue
        angle, length_m = numbers.angle[of], numbers.length_m[of]
        weight = length_m * numbers.contrast[of] / (1.0 + distance_m[of] / 10.0)
        turn = _turn(angle[:, None], angle[None])
        votes = (np.exp(-0.5 * (turn / 0.03) ** 2) * weight[None]).sum(axis=1)
        best = int(votes.argmax())
        if (turn[best] < 0.05) @ length_m > 3.0:
            return float(angle[best])
    return None


def _turn(angle: np.ndarray, direction: np.ndarray | float) -> np.ndarray:
    """Angle [rad] between lines without a sense."""
    return np.abs((angle - direction + np.pi / 2) % np.pi - np.pi / 2)


def _tolerance_rad(distance_m: np.ndarray) -> np.ndarray:
    """Roads bend: 3 deg near by, 0.25 deg more each metre beyond 10 m."""
    return np.deg2rad(3.0 + 0.25 * np.maximum(distance_m - 10.0, 0.0))


def _are_seams(numbers: _Numbers, of: np.ndarray, metres_per_px: float) -> np.ndarray:
    """Which strokes are far fainter than one that they are in line with, bool[of].

    A seam is thinner than paint, and where it is thinner than a pixel it is less bright instead: the product is both.
    """
    light_m = np.expm1(numbers.contrast[of]) * numbers.width_m[of]
    fainter = light_m[:, None] < SEAM * light_m
    return (fainter & _continue(numbers, of, of, metres_per_px, _SEAM_RAD)).any(axis=1)


def _continue(
    numbers: _Numbers, some: np.ndarray, of: np.ndarray, metres_per_px: float, turn_rad: float = _IN_LINE_RAD
) -> np.ndarray:
    """Whether strokes lie on the straight prolongation of others, within 0.1 m, some deg of them and 12 m away.

    Returns:
        bool[some of].
    """
    offset = (numbers.middle[some, None] - numbers.middle[of]) * metres_per_px
    tangent = np.stack([np.cos(numbers.angle[of]), np.sin(numbers.angle[of])], axis=-1)
    along = np.abs((offset * tangent).sum(axis=-1))
    across = np.abs(offset[..., 0] * tangent[:, 1] - offset[..., 1] * tangent[:, 0])
    turn = _turn(numbers.angle[some, None], numbers.angle[of])
    return (along < 12.0) & (across < 0.1 + 0.01 * along) & (turn < turn_rad)
