"""How well a top view fits together: disagreement of cameras, steps at the seams (room: perception; host).

In: a SurroundView and pictures. Out: millimetres between what two cameras show, grey levels across the seams.
What mounts and ground do (disagreement) and what blending does (steps) are kept apart: neither mends the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.perception.surround import SurroundView

_MOST_SPOTS, _QUALITY, _APART_M = 120, 0.02, 0.25
_PATCH_M, _REACH_M = 0.5, 0.3
_LEAST_SCORE, _LEAST_CONTRAST = 0.75, 8.0
_FLAT_RATIO = 0.1
"""Smaller against larger eigenvalue of the gradients of a patch: below, it is a line and tells one direction only."""
_BAND_M = 1.5
"""Spots farther from the seam are not shown by both cameras in any blend."""
_FINE_M, _WIDE_M, _SHADES_M = 0.05, 0.6, 0.05
"""Details that are compared are between the first two, on a raster of the third."""
_BESIDE_M = 0.6
"""Where the picture is compared with the seam: outside of what the blend touches."""
_ACROSS_M = 0.04


@dataclass(frozen=True)
class OverlapMatches:
    """The same spots of the road as two cameras show them.

    Attributes:
        apart_m: float64[n], distance between the two in the top view.
        cameras: int[n 2].
        num_tried: spots that were looked for.
        likeness: correlation of what the two cameras of each pair show, by pair.
    """

    apart_m: np.ndarray
    cameras: np.ndarray
    num_tried: int
    likeness: dict[tuple[int, int], float]


Band = tuple[int, int, np.ndarray]


def overlap_matches(
    view: SurroundView, images: Sequence[np.ndarray], bands: Sequence[Band] | None = None
) -> OverlapMatches:
    """Corners of paint and texture in one camera's top view, found again in that of its neighbour.

    Args:
        view: the top view.
        images: uint8[h w 3] of every camera.
        bands: pairs of `neighbours`, where they are known.
    """
    tops = [
        cv2.remap(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), uv, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        for image, uv in zip(images, view.image_uv, strict=True)
    ]
    apart, cameras, likeness, tried = [], [], {}, 0
    for i, j, band in neighbours(view) if bands is None else bands:
        likeness[i, j] = correlation(tops[i], tops[j], band, view.metres_per_px)
        found, num = _found_again(tops[i], tops[j], band, view.metres_per_px)
        apart.append(found)
        cameras.append(np.tile([i, j], (len(found), 1)))
        tried += num
    if not apart:
        return OverlapMatches(np.zeros(0), np.zeros((0, 2), int), 0, {})
    return OverlapMatches(np.concatenate(apart), np.concatenate(cameras), tried, likeness)


def seam_step(view: SurroundView, top: np.ndarray, bands: Sequence[Band] | None = None) -> tuple[float, float]:
    """Mean step of grey levels across the seams, and across the same lines moved aside [grey levels].

    Args:
        view: the top view.
        top: uint8[h w 3], stitched.
        bands: pairs of `inner_neighbours`, where they are known.
    """
    grey = cv2.cvtColor(top, cv2.COLOR_BGR2GRAY).astype(np.float32)
    at, beside = [], []
    aside_px, across_px = _BESIDE_M / view.metres_per_px, max(_ACROSS_M / view.metres_per_px, 1.0)
    for i, j, band in inner_neighbours(view) if bands is None else bands:
        line, normal = _seam((view.order[0] == i) & band, (view.order[0] == j) & band)
        if not len(line):
            continue
        at.append(_step(grey, line, normal, across_px))
        for side in (-aside_px, aside_px):
            beside.append(_step(grey, line + side * normal, normal, across_px))
    if not at:
        return float("nan"), float("nan")
    return float(np.concatenate(at).mean()), float(np.concatenate(beside).mean())


def inner_neighbours(view: SurroundView) -> list[Band]:
    """Pairs of cameras with the part of their overlap in which the picture beside a seam is of both, too."""
    return neighbours(view, 1.3 * _BESIDE_M)


def neighbours(view: SurroundView, inside_m: float = 0.0) -> list[Band]:
    """Pairs of cameras that share a seam, and where both see the road around it, bool[h w]."""
    found = []
    for i in range(len(view.image_uv)):
        for j in range(i + 1, len(view.image_uv)):
            both = view.seen[i] & view.seen[j]
            if inside_m:
                both = _distance(both) > inside_m / view.metres_per_px
            mine, other = both & (view.order[0] == i), both & (view.order[0] == j)
            if not (mine.any() and other.any()):
                continue
            reach = _BAND_M / view.metres_per_px
            band = both & (_distance(~mine) < reach) & (_distance(~other) < reach)
            if band.sum() * view.metres_per_px**2 > 0.3:
                found.append((i, j, band))
    return found


def _found_again(one: np.ndarray, other: np.ndarray, band: np.ndarray, metres_per_px: float) -> tuple[np.ndarray, int]:
    """Distances [m] between the spots of one top view and those of another, and how many spots were tried."""
    half, reach = max(round(0.5 * _PATCH_M / metres_per_px), 4), max(round(_REACH_M / metres_per_px), 3)
    spots = cv2.goodFeaturesToTrack(
        one, _MOST_SPOTS, _QUALITY, _APART_M / metres_per_px, mask=band.astype(np.uint8), blockSize=2 * (half // 2) + 1
    )
    apart, tried = [], 0
    for u, v in np.zeros((0, 2), int) if spots is None else np.round(spots[:, 0]).astype(int):
        outer = slice(v - half - reach, v + half + reach + 1), slice(u - half - reach, u + half + reach + 1)
        patch = one[v - half : v + half + 1, u - half : u + half + 1]
        if min(v, u) < half + reach or other[outer].shape != (2 * (half + reach) + 1,) * 2:
            continue
        if (patch == 0).any() or (other[outer] == 0).mean() > 0.02 or not tells_place(patch, _LEAST_CONTRAST):
            continue
        tried += 1
        place = peak(cv2.matchTemplate(other[outer], patch, cv2.TM_CCOEFF_NORMED))
        if place is not None and place[2] > _LEAST_SCORE:
            apart.append(float(np.hypot(place[0] - reach, place[1] - reach)) * metres_per_px)
    return np.array(apart), tried


def tells_place(patch: np.ndarray, least_contrast: float, flat_ratio: float = _FLAT_RATIO) -> bool:
    """Whether a patch has edges in two directions, above the noise."""
    if patch.std() < least_contrast:
        return False
    du, dv = (cv2.Sobel(patch.astype(np.float32), cv2.CV_32F, *axis) for axis in ((1, 0), (0, 1)))
    low, high = np.linalg.eigvalsh([[(du * du).sum(), (du * dv).sum()], [(du * dv).sum(), (dv * dv).sum()]])
    return bool(low > flat_ratio * high)


def peak(scores: np.ndarray) -> tuple[float, float, float] | None:
    """The best place (u, v) to a fraction of a pixel and its score; None where it lies on the border of the search."""
    v, u = (int(k) for k in np.unravel_index(int(scores.argmax()), scores.shape))
    if not (0 < v < scores.shape[0] - 1 and 0 < u < scores.shape[1] - 1):
        return None

    def vertex(low: float, mid: float, high: float) -> float:
        bend = low - 2.0 * mid + high
        return 0.0 if bend > -1e-9 else float(0.5 * (low - high) / bend)

    du = vertex(*(float(score) for score in scores[v, u - 1 : u + 2]))
    dv = vertex(*(float(score) for score in scores[v - 1 : v + 2, u]))
    return u + du, v + dv, float(scores[v, u])


def correlation(one: np.ndarray, other: np.ndarray, band: np.ndarray, metres_per_px: float) -> float:
    """Correlation of two top views where both see, of their details."""
    step = max(_SHADES_M / metres_per_px, 1.0)
    size = (round(one.shape[1] / step), round(one.shape[0] / step))
    inside = cv2.resize(band.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    details = []
    for picture in (one, other):
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        fine, wide = (cv2.GaussianBlur(small, None, length / _SHADES_M) for length in (_FINE_M, _WIDE_M))
        detail = (fine - wide)[inside]
        details.append(np.clip(detail - np.median(detail), -40.0, 40.0))
    a, b = details
    return float((a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-6))


def _distance(inside: np.ndarray) -> np.ndarray:
    return cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)


def _seam(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (u, v) between two regions, and the unit normals there."""
    distance = _distance(~one) - _distance(one)
    near = one & (cv2.dilate(other.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
    v, u = np.nonzero(near)
    smooth = cv2.GaussianBlur(distance, None, 3.0)
    normal = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1, 0)[v, u], cv2.Sobel(smooth, cv2.CV_32F, 0, 1)[v, u]], axis=1)
    length = np.linalg.norm(normal, axis=1)
    good = length > 1e-3
    return np.stack([u, v], axis=1)[good].astype(np.float32), normal[good] / length[good, None]


def _step(grey: np.ndarray, line: np.ndarray, normal: np.ndarray, across_px: float) -> np.ndarray:
    ends = [
        cv2.remap(grey, np.ascontiguousarray((line + side * across_px * normal)[None]), None, cv2.INTER_LINEAR)[0]
        for side in (-1.0, 1.0)
    ]
    return np.abs(ends[1] - ends[0])
