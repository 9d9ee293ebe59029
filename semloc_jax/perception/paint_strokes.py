"""Straight strokes of even width among the ridges of a top view (room: perception; host).

In: RidgeProfiles and the top view they come from. Out: Strokes with a smooth middle, a width and both ends.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.perception.paint_profiles import MIN_CONTRAST, Brightness, RidgeProfiles, measure_profiles

_BINS = 6
"""Directions in which points are linked; bins overlap by half."""
STEP_M = 0.1
"""Distance of the points along a stroke."""
_FINE_M = 0.01
_MAX_LENGTH_M = 12.0
"""Longer strokes are cut: a low polynomial follows so much of any lane line."""
_MOST_POINTS = 4000


@dataclass(frozen=True)
class Stroke:
    """One stroke in the top view.

    Args:
        uv: middle, one point each 0.1 m, float[n 2] in pixels of the top view.
        normal: unit vectors across, float[n 2].
        profiles: what is seen across the stroke at these points.
        painted: where both edges are seen, bool[n].
        width_m: median width.
        contrast: median contrast where it is painted.
        scatter_m: root mean square of its ridge around its middle.
        width_scatter: median deviation of the width as a share of it.
    """

    uv: np.ndarray
    normal: np.ndarray
    profiles: RidgeProfiles
    painted: np.ndarray
    width_m: float
    contrast: float
    scatter_m: float
    width_scatter: float

    @property
    def rise_m(self) -> float:
        """Median softness of its edges."""
        return float(np.median(self.profiles.rise_m[self.painted])) if self.painted.any() else np.inf

    @property
    def length_m(self) -> float:
        """Length on which both edges are seen."""
        return STEP_M * float(self.painted.sum())


def find_strokes(
    brightness: Brightness,
    shape: tuple[int, ...],
    ridges: RidgeProfiles,
    max_half_width_m: float,
    metres_per_px: float,
) -> list[Stroke]:
    """Strokes through the points of ridges, longest first; points that lie on no curve come out as poor strokes.

    Args:
        brightness: of the image at places of the top view: strokes are measured where it is sharpest.
        shape: height and width of the top view.
        ridges: points with two edges.
        max_half_width_m: of the scale at which they were found.
        metres_per_px: size of a pixel of the top view.
    """
    strokes = []
    for group in _groups(ridges, shape, metres_per_px):
        if np.median(ridges.contrast[group]) < MIN_CONTRAST:
            continue
        stroke = _fit(brightness, ridges.at(group), max_half_width_m, metres_per_px)
        if stroke is not None:
            strokes.append(stroke)
    return sorted(strokes, key=lambda stroke: -stroke.length_m)


def _groups(ridges: RidgeProfiles, shape: tuple[int, ...], metres_per_px: float) -> Iterator[np.ndarray]:
    """Indices of points that touch each other and run the same way."""
    angle = np.arctan2(-ridges.normal[:, 0], ridges.normal[:, 1]) % np.pi
    found = []
    u, v = ridges.uv.astype(int).T
    for number in range(_BINS):
        turn = np.abs((angle - np.pi * number / _BINS + np.pi / 2) % np.pi - np.pi / 2)
        member = np.flatnonzero(turn < np.pi / _BINS * 0.75)
        spots = np.zeros(shape, np.uint8)
        spots[v[member], u[member]] = 1
        # Gaps of a worn line, of noise: 0.2 m.
        reach = max(round(0.1 / metres_per_px), 1)
        joined = cv2.dilate(spots, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        label = cv2.connectedComponents(joined, connectivity=8)[1][v[member], u[member]]
        order = np.argsort(label, kind="stable")
        cuts = np.flatnonzero(np.diff(label[order])) + 1
        found += [member[part] for part in np.split(order, cuts) if len(part) * metres_per_px > 0.5]
    taken = np.zeros(len(ridges.uv), bool)
    for group in sorted(found, key=len, reverse=True):
        free = group[~taken[group]]
        if len(free) >= 0.5 * len(group):
            taken[free] = True
            yield from _cut(ridges.uv[free], free, metres_per_px)


def _cut(uv: np.ndarray, group: np.ndarray, metres_per_px: float) -> Iterator[np.ndarray]:
    """The group in parts of equal length along its main direction."""
    offset = uv - uv.mean(axis=0)
    along = offset @ np.linalg.eigh(offset.T @ offset)[1][:, 1] * metres_per_px
    length = np.ptp(along)
    parts = int(np.ceil(length / _MAX_LENGTH_M))
    number = np.minimum(((along - along.min()) / max(length, 1e-6) * parts).astype(int), parts - 1)
    for part in range(parts):
        members = group[number == part]
        if len(members) * metres_per_px > 0.5:
            yield members[:: len(members) // _MOST_POINTS + 1]


def _fit(brightness: Brightness, points: RidgeProfiles, max_half_width_m: float, metres_per_px: float) -> Stroke | None:
    """The smooth stroke through points, measured again along its whole length; None where too few lie on a curve."""
    middle_m = 0.5 * (points.left_m + points.right_m)
    uv = points.uv + points.normal * (middle_m / metres_per_px)[:, None]
    centre = uv.mean(axis=0)
    axis = np.linalg.eigh((uv - centre).T @ (uv - centre))[1][:, ::-1]
    s, d = ((uv - centre) @ axis * metres_per_px).T
    length = np.ptp(s)
    if length < 0.4:
        return None
    degree = 1 if length < 2.5 else 2 if length < 6.0 else 3
    # The edges of single points wander; few wild ones must not turn the curve.
    weight = np.ones_like(s)
    for _ in range(3):
        curve = np.polynomial.Polynomial.fit(s, d, degree, w=weight)
        weight = 1.0 / (1.0 + ((d - curve(s)) / 0.03) ** 2)
    scatter = float(np.sqrt(np.mean(np.minimum(np.abs(d - curve(s)), 0.15) ** 2)))
    at = np.arange(s.min() - 0.5, s.max() + 0.5, STEP_M)
    tangent = axis[:, 0] + curve.deriv()(at)[:, None] * axis[:, 1]
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    line = centre + (at[:, None] * axis[:, 0] + curve(at)[:, None] * axis[:, 1]) / metres_per_px
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=-1)
    profiles = measure_profiles(brightness, line, normal, max_half_width_m, metres_per_px, _FINE_M)
    own = (at >= s.min()) & (at <= s.max())
    contrast = float(np.median(profiles.contrast[own]))
    width = float(np.median(profiles.width_m[own]))
    # An end lies where half of the contrast near by is left; between shadow and sun the contrast itself changes.
    near = cv2.dilate(cv2.blur(profiles.contrast[None], (5, 1)), np.ones((1, 21), np.uint8))[0]
    painted = (profiles.contrast > np.maximum(0.5 * near, MIN_CONTRAST)) & (
        np.abs(profiles.width_m - width) < 0.5 * width + 0.03
    )
    spread = float(np.median(np.abs(profiles.width_m[own] - width)) / max(width, 0.03))
    return Stroke(line, profiles.normal, profiles, painted, width, contrast, scatter, spread)
