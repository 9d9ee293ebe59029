"""Smooth curves through groups of ridge points of a top view, all at once (room: perception; host).

In: RidgeProfiles in groups of points that touch each other. Out: PaintCurves, points each 0.1 m along polynomials.
"""

from dataclasses import dataclass

import numpy as np

from semloc_jax.perception.paint_profiles import RidgeProfiles
from semloc_jax.perception.point_groups import PointGroups

STEP_M = 0.1
"""Distance of the points along a curve."""
_BEYOND_M = 0.5
"""Curves go on this far beyond their points: a stroke may end there."""
_SHORTEST_M = 0.4
_BENT_FROM_M = (2.5, 6.0)
"""Lengths from which a curve is a parabola, a cubic."""
_POWERS = 2 + len(_BENT_FROM_M)
_WILD_M = 0.03
"""The edges of single points wander; few wild ones must not turn the curve: beyond this distance they count less."""
_FAR_M = 0.15
"""No point counts as farther than this in the scatter."""


@dataclass(frozen=True)
class PaintCurves:
    """Curves in the top view; arrays [n] of the points of all curves, one curve after the other, or [curves]."""

    groups: PointGroups
    """Which points make a curve."""
    uv: np.ndarray
    """Points each 0.1 m, float[n 2] in pixels of the top view."""
    normal: np.ndarray
    """Unit vectors across, float[n 2]."""
    own: np.ndarray
    """Whether a point lies within the ridge the curve comes from, bool[n]; false beyond its ends."""
    scatter_m: np.ndarray
    """Root mean square of the ridge around the curve, float[curves]."""


@dataclass(frozen=True)
class _Sides:
    """Groups of points by their places along and across their main direction."""

    groups: PointGroups
    centre: np.ndarray
    """Mean, float[groups 2], pixels of the top view."""
    axes: np.ndarray
    """Unit vectors along and across as columns, float[groups 2 2]."""
    along_m: np.ndarray
    """float[n]."""
    across_m: np.ndarray
    """float[n]."""

    @property
    def first_m(self) -> np.ndarray:
        """Least place along, float[groups]."""
        return self.groups.least(self.along_m)

    @property
    def last_m(self) -> np.ndarray:
        """Largest place along, float[groups]."""
        return self.groups.most(self.along_m)

    def only(self, keep: np.ndarray) -> "_Sides":
        """Some of the groups, by mask bool[groups]."""
        kept = keep[self.groups.number]
        groups = PointGroups(self.groups.sizes[keep])
        return _Sides(groups, self.centre[keep], self.axes[keep], self.along_m[kept], self.across_m[kept])


@dataclass(frozen=True)
class _Polynomials:
    """Places across as polynomials of the places along, scaled to -1...1 between first and last point."""

    first_m: np.ndarray
    length_m: np.ndarray
    coefficients: np.ndarray
    """By power, float[groups 4], 0 above the degree."""

    def at(self, along_m: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place across [m] and its slope at places along the curves of these numbers, float[n] both."""
        powers = _powers(along_m, self.first_m[number], self.length_m[number])
        slopes = self.coefficients[:, 1:] * (np.arange(1, _POWERS) * 2.0 / self.length_m[:, None])
        return (powers * self.coefficients[number]).sum(axis=1), (powers[:, :-1] * slopes[number]).sum(axis=1)


def fit_curves(points: RidgeProfiles, groups: PointGroups, metres_per_px: float, max_scatter_m: float) -> PaintCurves:
    """The smooth curve through each group of points; groups that are too short or lie on no curve are left out.

    Args:
        points: ridge points, group after group.
        groups: which points belong together.
        metres_per_px: size of a pixel of the top view.
        max_scatter_m: root mean square distance from its curve with which a group still lies on it.
    """
    sides = _in_own_axes(points, groups, metres_per_px)
    sides = sides.only(sides.last_m - sides.first_m >= _SHORTEST_M)
    curves = _robust_polynomials(sides)
    off_m = sides.across_m - curves.at(sides.along_m, sides.groups.number)[0]
    scatter_m = np.sqrt(sides.groups.mean(np.minimum(np.abs(off_m), _FAR_M) ** 2))
    return _points_along(sides, curves, scatter_m, np.flatnonzero(scatter_m <= max_scatter_m), metres_per_px)


def _in_own_axes(points: RidgeProfiles, groups: PointGroups, metres_per_px: float) -> _Sides:
    """Middles between both edges along and across the main direction of their group."""
    middle_m = 0.5 * (points.left_m + points.right_m)
    uv = points.uv + points.normal * (middle_m / metres_per_px)[:, None]
    centre = groups.mean(uv)
    offset = uv - centre[groups.number]
    axes = np.linalg.eigh(groups.total(offset[:, :, None] * offset[:, None, :]))[1][..., ::-1]
    along_m, across_m = (offset[:, :, None] * axes[groups.number]).sum(axis=1).T * metres_per_px
    return _Sides(groups, centre, axes, along_m, across_m)


def _robust_polynomials(sides: _Sides) -> _Polynomials:
    """Polynomials through most points of each group."""
    groups, first_m, length_m = sides.groups, sides.first_m, sides.last_m - sides.first_m
    degree = 1 + sum((length_m >= least).astype(int) for least in _BENT_FROM_M)
    has = np.arange(_POWERS) <= degree[:, None]
    powers = _powers(sides.along_m, first_m[groups.number], length_m[groups.number]) * has[groups.number]
    weight = np.ones_like(sides.along_m)
    for _ in range(3):
        rows = powers * weight[:, None]
        squares = groups.total(rows[:, :, None] * rows[:, None, :])
        # A power that a curve has not keeps the coefficient 0.
        squares[:, range(_POWERS), range(_POWERS)] += ~has
        products = groups.total(rows * (weight * sides.across_m)[:, None])
        coefficients = np.linalg.solve(squares, products[..., None])[..., 0]
        off_m = sides.across_m - (powers * coefficients[groups.number]).sum(axis=1)
        weight = 1.0 / (1.0 + (off_m / _WILD_M) ** 2)
    return _Polynomials(first_m, length_m, coefficients)


def _powers(along_m: np.ndarray, first_m: np.ndarray, length_m: np.ndarray) -> np.ndarray:
    """Powers of places along scaled to -1...1, float[n 4]."""
    return np.vander(2.0 * (along_m - first_m) / length_m - 1.0, _POWERS, increasing=True)


def _points_along(
    sides: _Sides, curves: _Polynomials, scatter_m: np.ndarray, chosen: np.ndarray, metres_per_px: float
) -> PaintCurves:
    """Points of the chosen curves and beyond both their ends."""
    start_m, end_m = sides.first_m[chosen] - _BEYOND_M, sides.last_m[chosen] + _BEYOND_M
    groups = PointGroups(np.ceil((end_m - start_m) / STEP_M).astype(int))
    along_m = start_m[groups.number] + groups.rank * (start_m + STEP_M - start_m)[groups.number]
    number = chosen[groups.number]
    across_m, slope = curves.at(along_m, number)
    along, across = np.moveaxis(sides.axes[number], -1, 0)
    tangent = along + slope[:, None] * across
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    uv = sides.centre[number] + (along_m[:, None] * along + across_m[:, None] * across) / metres_per_px
    own = (along_m >= sides.first_m[number]) & (along_m <= sides.last_m[number])
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=-1)
    return PaintCurves(groups, uv, normal, own, scatter_m[chosen])
