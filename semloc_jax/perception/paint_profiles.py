"""Profiles across bright ridges of a top view: two edges, a width, a contrast on each side (room: perception; host).

In: the top view of one image. Out: RidgeProfiles, one row for each point of a ridge, of paint and of much else.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

_DARK = 10.0
"""Added to brightness before the logarithm: noise of dark pixels must not count as contrast."""
_ALONG_M = (-0.3, -0.15, 0.0, 0.15, 0.3)
"""Profiles are means over these places along the stroke."""
MIN_CONTRAST = 0.08
"""Least difference of log brightness between a stroke and the road on either side."""
_CORE_M = 0.025
_FLANK_M = (0.04, 0.2)
"""The road beside a stroke is looked at between these distances from its edge."""
_STRIP_M = 0.075
"""The darkest strip of this width counts there: beside an edge line a bright verge may begin soon."""


_BLOCK = 30_000
"""Samples taken at once: they stay in the processor's cache, and OpenCV's pictures must be below 32768 pixels wide."""

Brightness = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Brightness, float32[...], at columns and rows of the top view, both float32[...] in its pixels."""


@dataclass(frozen=True)
class RidgeScale:
    """Strokes of one range of widths."""

    sigma_m: float
    """Of the smoothing under which the ridge is found."""
    max_half_width_m: float
    min_strength: float
    """Least curvature across the ridge, in the logarithm of brightness, times sigma squared."""


THIN = RidgeScale(0.06, 0.16, 0.012)
"""Lane lines."""
WIDE = RidgeScale(0.18, 0.36, 0.03)
"""Stop lines, bars of crosswalks, stems of arrows."""


@dataclass(frozen=True)
class RidgeProfiles:
    """Points of ridges; all arrays [n]. Lengths in metres, contrasts as differences of log brightness."""

    uv: np.ndarray
    """Place in the top view [px], float[n 2]."""
    normal: np.ndarray
    """Unit vector across the stroke in the top view, float[n 2]."""
    left_m: np.ndarray
    """Distance of the left edge along the normal, negative."""
    right_m: np.ndarray
    contrast_left: np.ndarray
    contrast_right: np.ndarray
    rise_m: np.ndarray
    """Distance over which the softer edge falls from three to one quarter: paint is as sharp as the picture."""

    @property
    def width_m(self) -> np.ndarray:
        """Distance between both edges."""
        return self.right_m - self.left_m

    @property
    def contrast(self) -> np.ndarray:
        """The smaller of both sides: an edge between two surfaces has none."""
        return np.minimum(self.contrast_left, self.contrast_right)

    def at(self, keep: np.ndarray | slice) -> "RidgeProfiles":
        """Some of the points, by mask, index or slice."""
        return RidgeProfiles(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


def log_brightness(grey: np.ndarray) -> np.ndarray:
    """Logarithm of brightness: a shadow shifts it, the contrast of paint and road stays."""
    return np.log(grey + np.float32(_DARK))


def find_ridges(
    grey: np.ndarray, visible: np.ndarray, scale: RidgeScale, metres_per_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """Places [px] and unit vectors across of the ridges of one scale that stand out on both sides, float[n 2] both.

    Args:
        grey: brightness of the top view, float32[h w].
        visible: what the camera sees of the road, bool[h w].
        scale: widths to look for.
        metres_per_px: size of a pixel of the top view.
    """
    uv, normal = _ridge_points(log_brightness(grey), visible, scale, metres_per_px)
    # Most ridges are grass and gravel: one look at both sides settles them.
    beside_m = scale.max_half_width_m + 0.5 * sum(_FLANK_M)
    look = _sampled(partial(lookup, grey), uv, normal, np.array([-beside_m, 0.0, beside_m]), metres_per_px)
    stands_out = _contrast(look[1], np.maximum(look[0], look[2])) > 0.5 * MIN_CONTRAST
    return uv[stands_out], normal[stands_out]


def measure_profiles(
    brightness: Brightness,
    uv: np.ndarray,
    normal: np.ndarray,
    max_half_width_m: float,
    metres_per_px: float,
    step_m: float = 0.025,
) -> RidgeProfiles:
    """Edges and contrasts of strokes whose centres and directions are known.

    The edges lie halfway between the brightness of the stroke and that of the road beside it.

    Args:
        brightness: of the top view, or of the image at places of the top view.
        uv: places [px], float[n 2].
        normal: unit vectors across, float[n 2].
        max_half_width_m: edges are looked for up to here.
        metres_per_px: size of a pixel of the top view.
        step_m: distance of the samples across.
    """
    reach = max_half_width_m + _FLANK_M[1]
    half, core = round(reach / step_m), round(_CORE_M / step_m)
    across = np.arange(-half, half + 1) * step_m
    profile = _sampled(brightness, uv, normal, across, metres_per_px)
    middle = profile[half - core : half + core + 1].mean(axis=0)
    left, contrast_left, rise_left = _side(profile[half::-1], middle, max_half_width_m, step_m)
    right, contrast_right, rise_right = _side(profile[half:], middle, max_half_width_m, step_m)
    return RidgeProfiles(uv, normal, -left, right, contrast_left, contrast_right, np.maximum(rise_left, rise_right))


def _side(outward: np.ndarray, middle: np.ndarray, max_half_width_m: float, step_m: float) -> tuple[np.ndarray, ...]:
    """Distance of the edge [m], contrast to the road beyond it and softness [m]; profiles [k n] start in the middle.

    Light adds up in a pixel, so the edge lies halfway between the brightnesses, not between their logarithms.
    """
    inner, outer = (round(distance / step_m) for distance in _FLANK_M)
    strip = round(_STRIP_M / step_m)
    flank = outward[: round(max_half_width_m / step_m) + outer].min(axis=0)
    # Twice: the lowest level finds the road, the level of the road the edge.
    for _ in range(2):
        edge = _crossing(outward, middle, flank, 0.5)
        flank = _darkest_strip(outward, np.rint(edge).astype(np.intp) + inner + 1, outer - inner, strip)
    high, low = (_crossing(outward, middle, flank, share) for share in (0.75, 0.25))
    return edge * step_m, _contrast(middle, flank), (low - high) * step_m


def _darkest_strip(outward: np.ndarray, first: np.ndarray, count: int, width: int) -> np.ndarray:
    """Least mean brightness of `width` steps among `count` of them from the first on; the last one goes on."""
    columns = np.arange(len(first))
    beside = [outward.take(np.minimum(first + step, len(outward) - 1) * len(first) + columns) for step in range(count)]
    total = sum(beside[1:width], start=beside[0])
    least = total.copy()
    for entering, leaving in zip(beside[width:], beside, strict=False):
        total += entering
        total -= leaving
        np.minimum(least, total, out=least)
    return least / np.float32(width)


def _contrast(middle: np.ndarray, flank: np.ndarray) -> np.ndarray:
    """Difference of log brightness."""
    return np.log((np.maximum(middle, 0.0) + _DARK) / (np.maximum(flank, 0.0) + _DARK))


def _crossing(outward: np.ndarray, middle: np.ndarray, flank: np.ndarray, share: float) -> np.ndarray:
    """Step at which profiles first fall below a share of the way from the flank to the middle."""
    limit = flank + np.float32(share) * (middle - flank)
    above = np.ones(limit.shape, bool)
    first = np.ones(limit.shape, np.intp)
    # Row by row: numpy looks for a first element along rows only slowly. The last step counts as below.
    for row in outward[1:-1]:
        above &= row >= limit
        first += above
    at = first * limit.size + np.arange(limit.size)
    after, before = outward.take(at), outward.take(at - limit.size)
    return first - 1 + np.clip((before - limit) / np.maximum(before - after, 1e-6), 0.0, 1.0)


def _sampled(
    brightness: Brightness, uv: np.ndarray, normal: np.ndarray, across_m: np.ndarray, metres_per_px: float
) -> np.ndarray:
    """Mean brightness along the strokes at distances across them, float32[k n]."""
    places = uv.T.astype(np.float32)
    normals = normal.T.astype(np.float32)
    along = np.stack([-normals[1], normals[0]])
    offsets_px = (across_m / metres_per_px).astype(np.float32)[:, None]
    profile = np.empty((len(across_m), len(uv)), np.float32)
    size = max(_BLOCK // len(across_m), 1)
    for part in (slice(first, first + size) for first in range(0, len(uv), size)):
        offset = normals[:, None, part] * offsets_px
        at, total = np.empty_like(offset), np.float32(0)
        for distance in _ALONG_M:
            place = places[:, part] + along[:, part] * np.float32(distance / metres_per_px)
            total = total + brightness(*np.add(place[:, None], offset, out=at))
        profile[:, part] = total / np.float32(len(_ALONG_M))
    return profile


def lookup(values: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Values, float32[h w], between pixels at columns and rows, float32[...]."""
    u_row, v_row = u.reshape(1, -1), v.reshape(1, -1)
    found = [
        cv2.remap(values, u_row[:, part], v_row[:, part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in (slice(first, first + _BLOCK) for first in range(0, u.size, _BLOCK))
    ]
    return (found[0] if len(found) == 1 else np.concatenate(found or [u_row], axis=1)).reshape(u.shape)


def _ridge_points(
    level: np.ndarray, visible: np.ndarray, scale: RidgeScale, metres_per_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """Places [px] where the curvature across is largest, and the directions across."""
    sigma = scale.sigma_m / metres_per_px
    smooth = cv2.GaussianBlur(level, (0, 0), sigma)
    uu, vv, uv = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=0.25) for order in ((2, 0), (0, 2), (1, 1)))
    half = (uu - vv) * np.float32(0.5)
    root = np.sqrt(half * half + uv * uv)
    strength = root - (uu + vv) * np.float32(0.5)
    strength *= np.float32(sigma**2)
    inner = cv2.erode(visible.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    number = np.flatnonzero(inner & (strength > scale.min_strength))
    own, half, root, uv = (values.take(number) for values in (strength, half, root, uv))
    row, column = np.divmod(number.astype(np.int32), np.int32(level.shape[1]))
    at, normal = np.stack([column, row]).astype(np.float32), _across(half, uv, root)
    for is_below, side in ((np.less_equal, 1), (np.less, -1)):
        peak = np.flatnonzero(is_below(lookup(strength, *(at + side * normal)), own))
        own, at, normal = own.take(peak), at.take(peak, axis=1), normal.take(peak, axis=1)
    return at.T.astype(np.float64), np.ascontiguousarray(normal.T)


def _across(half: np.ndarray, uv: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Unit vectors, float32[2 n], of the least curvature: half the difference of both, the mixed one, their root."""
    root = np.maximum(root, np.float32(1e-12))
    cosine, sine = half / root, uv / root
    larger = np.sqrt(np.float32(0.5) + np.float32(0.5) * np.abs(cosine))
    smaller = np.float32(0.5) * sine / larger
    return np.where(cosine < 0.0, [np.copysign(larger, -sine), np.abs(smaller)], [-smaller, larger])
