"""Straight strokes of even width among the ridges of a top view (room: perception; host).

In: RidgeProfiles and the top view they come from. Out: Strokes with a smooth middle, a width and both ends.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.perception.paint_curves import STEP_M, PaintCurves, fit_curves
from semloc_jax.perception.paint_profiles import MIN_CONTRAST, Brightness, RidgeProfiles, measure_profiles
from semloc_jax.perception.point_groups import PointGroups

_BINS = 6
"""Directions in which points are linked; bins overlap by half."""
_FINE_M = 0.01
SEAM = 0.2
"""Less light, excess of brightness times width, than this share of what is painted comes from a seam of the road."""
_MAX_LENGTH_M = 12.0
"""Longer strokes are cut: a low polynomial follows so much of any lane line."""
_SHORTEST_M = 0.5
"""Shorter strokes are paint in no direction."""
_SHORTEST_GROUP_M = 0.5
"""Groups with fewer points than pixels on this length are specks."""
_MOST_POINTS = 4000


@dataclass(frozen=True)
class Stroke:
    """One stroke in the top view.

    Args:
        profiles: what is seen across the stroke at the points of its middle, one each 0.1 m.
        painted: where both edges are seen, bool[n].
        middle: mean of the points that are painted, of all where none is, float[2] in pixels of the top view.
        width_m: median width.
        length_m: length on which both edges are seen.
        contrast: median contrast where it is painted.
        scatter_m: root mean square of its ridge around its middle.
        width_scatter: median deviation of the width as a share of it.
        rise_m: median softness of its edges, infinite where none is seen.
    """

    profiles: RidgeProfiles
    painted: np.ndarray
    middle: np.ndarray
    width_m: float
    length_m: float
    contrast: float
    scatter_m: float
    width_scatter: float
    rise_m: float

    @property
    def uv(self) -> np.ndarray:
        """Points of its middle, float[n 2] in pixels of the top view."""
        return self.profiles.uv

    @property
    def normal(self) -> np.ndarray:
        """Unit vectors across, float[n 2]."""
        return self.profiles.normal


def find_strokes(
    brightness: Brightness,
    ridges: RidgeProfiles,
    max_half_width_m: float,
    metres_per_px: float,
    max_scatter_m: float,
) -> list[Stroke]:
    """Strokes of at least half a metre through the points of ridges, longest first.

    Args:
        brightness: of the image at places of the top view: strokes are measured where it is sharpest.
        ridges: points with two edges.
        max_half_width_m: of the scale at which they were found.
        metres_per_px: size of a pixel of the top view.
        max_scatter_m: points that lie on no curve, by root mean square, are not measured.
    """
    found = _contrasting(_groups(ridges, metres_per_px), ridges.contrast)
    if not found:
        return []
    curves = fit_curves(ridges.at(np.concatenate(found)), _sizes(found), metres_per_px, max_scatter_m)
    profiles = measure_profiles(brightness, curves.uv, curves.normal, max_half_width_m, metres_per_px, _FINE_M)
    return sorted(_measured(curves, profiles), key=lambda stroke: -stroke.length_m)


def _sizes(parts: Sequence[np.ndarray]) -> PointGroups:
    return PointGroups([len(part) for part in parts])


def _contrasting(parts: list[np.ndarray], contrast: np.ndarray) -> list[np.ndarray]:
    """Groups of points, by index, whose median contrast is that of a stroke."""
    if not parts:
        return []
    own = contrast[np.concatenate(parts)]
    medians = _sizes(parts).median(own, np.ones(len(own), bool))
    return [part for part, median in zip(parts, medians, strict=True) if median >= MIN_CONTRAST]


def _groups(ridges: RidgeProfiles, metres_per_px: float) -> list[np.ndarray]:
    """Indices of points that touch each other and run the same way."""
    angle = np.arctan2(-ridges.normal[:, 0], ridges.normal[:, 1]) % np.pi
    found = []
    u, v = ridges.uv.astype(int).T
    for number in range(_BINS):
        turn = np.abs((angle - np.pi * number / _BINS + np.pi / 2) % np.pi - np.pi / 2)
        member = np.flatnonzero(turn < np.pi / _BINS * 0.75)
        label = _touching(u[member], v[member], metres_per_px)
        # Most groups are specks: only the others are put in order.
        long = np.flatnonzero((np.bincount(label) * metres_per_px > _SHORTEST_GROUP_M)[label])
        order = long[np.argsort(label[long], kind="stable")]
        found += np.split(member[order], np.flatnonzero(np.diff(label[order])) + 1) if len(order) else []
    taken = np.zeros(len(ridges.uv), bool)
    groups = []
    for group in sorted(found, key=len, reverse=True):
        free = group[~taken[group]]
        if len(free) >= 0.5 * len(group):
            taken[free] = True
            groups.append(free)
    return _cut_long(ridges.uv, groups, metres_per_px)


def _cut_long(uv: np.ndarray, groups: list[np.ndarray], metres_per_px: float) -> list[np.ndarray]:
    """Groups of points, by index, none of them longer than a stroke may be, and none with fewer than it must have."""
    if not groups:
        return []
    parts, sizes = [], _sizes(groups)
    u, v = uv[np.concatenate(groups)].T
    extent_m = np.hypot(*(sizes.most(side) - sizes.least(side) for side in (u, v))) * metres_per_px
    for group, is_long in zip(groups, extent_m >= _MAX_LENGTH_M, strict=True):
        parts += _cut(uv[group], group, metres_per_px) if is_long else [group]
    return [part[:: len(part) // _MOST_POINTS + 1] for part in parts if len(part) * metres_per_px > _SHORTEST_GROUP_M]


def _touching(u: np.ndarray, v: np.ndarray, metres_per_px: float) -> np.ndarray:
    """Numbers of groups of points, columns and rows int[n], with gaps of at most 0.2 m: worn lines, noise."""
    if not len(u):
        return np.zeros(0, np.int32)
    reach = max(round(0.1 / metres_per_px), 1)
    row, column = v - v.min() + reach, u - u.min() + reach
    spots = np.zeros((row.max() + reach + 1, column.max() + reach + 1), np.uint8)
    spots[row, column] = 1
    joined = cv2.dilate(spots, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    return cv2.connectedComponents(joined, connectivity=8)[1][row, column]


def _cut(uv: np.ndarray, group: np.ndarray, metres_per_px: float) -> list[np.ndarray]:
    """The group in parts of equal length along its main direction."""
    offset = uv - uv.mean(axis=0)
    along = offset @ np.linalg.eigh(offset.T @ offset)[1][:, 1] * metres_per_px
    parts = int(np.ceil(np.ptp(along) / _MAX_LENGTH_M))
    number = np.minimum(((along - along.min()) / np.ptp(along) * parts).astype(int), parts - 1)
    return [group[number == part] for part in range(parts)]


def _measured(curves: PaintCurves, profiles: RidgeProfiles) -> list[Stroke]:
    """Strokes along curves from what is seen across them."""
    groups = curves.groups
    contrast, width_m = profiles.contrast, profiles.width_m
    own_width_m = groups.median(width_m, curves.own)
    deviation_m = np.abs(width_m - own_width_m[groups.number])
    usual_m = own_width_m[groups.number]
    # A seam of the road may go on where a dash ends: it is thinner, or less bright where it is thinner than a pixel.
    light_m = np.expm1(np.maximum(contrast, 0.0)) * width_m
    bright = light_m > SEAM * groups.quantiles(light_m, 0.9)[0, groups.number]
    as_wide = (width_m > 0.5 * usual_m) & (width_m < 1.5 * usual_m + 0.03) & bright
    painted = (contrast > np.maximum(0.5 * _contrast_nearby(contrast, groups), MIN_CONTRAST)) & as_wide
    count = groups.total(painted.astype(int))
    counted = painted | (count == 0)[groups.number]
    columns = (
        groups.total(curves.uv * counted[:, None]) / groups.total(counted.astype(int))[:, None],
        own_width_m,
        STEP_M * count,
        groups.median(contrast, curves.own),
        curves.scatter_m,
        groups.median(deviation_m, curves.own) / np.maximum(own_width_m, 0.03),
        groups.median(profiles.rise_m, painted),
    )
    numbers = zip(*(column.tolist() if column.ndim == 1 else column for column in columns), strict=True)
    is_long = STEP_M * count >= _SHORTEST_M
    return [
        Stroke(profiles.at(part), painted[part], *values)
        for part, values, keep in zip(groups.slices, numbers, is_long, strict=True)
        if keep
    ]


def _contrast_nearby(contrast: np.ndarray, groups: PointGroups) -> np.ndarray:
    """Largest contrast within 1 m along the stroke, means of 0.5 m; float32[n].

    An end lies where half of it is left; between shadow and sun the contrast itself changes.
    """
    kernel = np.ones((1, 21), np.uint8)
    parts = [cv2.dilate(cv2.blur(contrast[None, part], (5, 1)), kernel)[0] for part in groups.slices]
    return np.concatenate([np.zeros(0, np.float32), *parts])
