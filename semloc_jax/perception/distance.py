"""Signed distance to the boundary of a binary mask with sub-pixel accuracy (room: perception; host).

In: one binary layer of a mask. Out: float32 distance in pixels, negative inside, and the boxes where it matters.
"""

from functools import lru_cache
from statistics import NormalDist

import cv2
import numpy as np

from semloc_jax.native.mask_ramps import Smoothing

BLOCK_PX = 16
"""Boxes begin and end at multiples of this; every pyramid stride divides it."""
_COARSE_BLUR_PX = 0.6
_HALF_PX = 0.5
_COARSE_HALF_PX, _COARSE_OUTSET_PX = 0.35, 0.3
"""Far from an edge at any angle some pixel centre lies nearer than half a pixel; found by experiment."""


def signed_distance(binary: np.ndarray, blur_px: float) -> np.ndarray:
    """Signed distance [px] of every pixel centre to the boundary of a binary mask, float32[h w], negative inside.

    Far from the boundary it is the Euclidean distance to the nearest pixel of the other side less half a pixel, as the
    boundary lies midway between two centres. Near the boundary that distance is a staircase; there the mask is
    smoothed, and the level of a smoothed straight edge, s = Phi(-d / blur_px), is solved for d.

    Args:
        binary: uint8[h w], 0 outside, 255 inside.
        blur_px: standard deviation of the smoothing; 0 gives the plain distance transform.
    """
    far = _plain_distance(binary)
    return _near_edge(far, binary, _thin(binary, blur_px), blur_px, blur_px) if blur_px > 0 else far


def refined_signed_distance(binary: np.ndarray, coarse: np.ndarray, blur_px: float) -> np.ndarray:
    """signed_distance with the far part taken from coarse_signed_distance instead of a transform at full size.

    Args:
        binary: uint8[h w], 0 outside, 255 inside.
        coarse: signed distance of the same box at a reduced size [px of the full mask].
        blur_px: as in signed_distance, positive.
    """
    far = cv2.resize(coarse, binary.shape[::-1], interpolation=cv2.INTER_LINEAR)
    thin = _thin(binary, blur_px)
    if thin is not None:
        # Lines of a pixel or two need the exact transform, but seldom fill much of the box.
        x, y, w, h = cv2.boundingRect(thin)
        rows, columns = slice(max(y - 4, 0), y + h + 4), slice(max(x - 4, 0), x + w + 4)
        exact = _plain_distance(binary[rows, columns])
        cv2.copyTo(exact, thin[rows, columns], far[rows, columns])
    return _near_edge(far, binary, thin, blur_px, blur_px)


def coarse_signed_distance(binary: np.ndarray, stride: int, blur_px: float) -> np.ndarray:
    """The signed distance [px of the full mask] at every pixel of a mask reduced `stride` times, float32[h w].

    The reduced mask is the covered share of each block, so edges keep their sub-pixel place; blocks with a quarter of
    their area covered count as inside, so that thin lines survive.

    Args:
        binary: uint8[h w], 0 outside, 255 inside, h and w multiples of `stride`.
        stride: pixels of the full mask in one of the result.
        blur_px: as in signed_distance.
    """
    size = binary.shape[1] // stride, binary.shape[0] // stride
    share = cv2.resize(binary, size, interpolation=cv2.INTER_AREA)
    inside = cv2.compare(share, 63, cv2.CMP_GT)
    # The quarter rule puts the boundary a little outside.
    distance = _plain_distance(inside, _COARSE_HALF_PX, _COARSE_OUTSET_PX)
    if blur_px > 0:
        blur, sigma = _coarse_edge(stride, blur_px)
        distance = _near_edge(distance, share, _thin(inside, blur), blur, sigma)
    return cv2.multiply(distance, float(stride))


def edge_at(stride: int, blur_px: float) -> Smoothing:
    """What turns a mask into a distance near its border, for the native kernel: as in signed_distance at stride 1, as
    in coarse_signed_distance at a reduced size."""
    if stride == 1:
        return Smoothing(blur_px, *_edge_tables(blur_px), _HALF_PX, 0.0)
    blur, sigma = _coarse_edge(stride, blur_px)
    return Smoothing(blur, *_edge_tables(sigma), _COARSE_HALF_PX, _COARSE_OUTSET_PX)


def _coarse_edge(stride: int, blur_px: float) -> tuple[float, float]:
    """Smoothing of the covered share and the width of an edge in it [px of the reduced mask]."""
    blur = max(blur_px / stride, _COARSE_BLUR_PX)
    # The mean over a block is itself a smoothing.
    return blur, float(np.hypot(blur, 0.5 / np.sqrt(3.0)))


def _plain_distance(inside: np.ndarray, half: float = _HALF_PX, outset: float = 0.0) -> np.ndarray:
    """Distance transform with sign, less the `half` pixel from the nearest centre of the other side to the boundary.

    The true boundary lies `outset` pixels inside that of the mask.
    """
    distance = cv2.distanceTransform(cv2.bitwise_not(inside), cv2.DIST_L2, cv2.DIST_MASK_5)
    distance = cv2.subtract(distance, cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_5))
    # One of the two is 0 at every pixel, so the half pixel is taken off by the sign.
    return cv2.subtract(distance, cv2.LUT(inside, _half_pixel(half, outset)))


def _near_edge(far: np.ndarray, share: np.ndarray, thin: np.ndarray | None, blur: float, sigma: float) -> np.ndarray:
    """The plain distance with its staircase near the boundary replaced by the distance from the smoothed mask.

    Args:
        far: plain signed distance [px], float32[h w].
        share: covered share of each pixel, 0...255, uint8[h w].
        thin: where the plain distance must stay, 0 or 255.
        blur: standard deviation of the smoothing of `share` [px].
        sigma: that of the edge in the smoothed share [px].
    """
    smooth = cv2.GaussianBlur(share, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
    keep, add = (cv2.LUT(smooth, table) for table in _edge_tables(sigma))
    if thin is not None:
        keep[thin > 0], add[thin > 0] = 1.0, 0.0
    return cv2.add(cv2.multiply(far, keep), add)


def occupied_blocks(binary: np.ndarray) -> np.ndarray:
    """Which blocks of BLOCK_PX x BLOCK_PX pixels hold any of the mask, uint8[h/BLOCK_PX w/BLOCK_PX].

    Args:
        binary: uint8[h w], h and w multiples of BLOCK_PX.
    """
    height, width = binary.shape[0] // BLOCK_PX, binary.shape[1] // BLOCK_PX
    words = np.ascontiguousarray(binary).view(np.uint64).reshape(height, BLOCK_PX, -1)
    words = np.bitwise_or.reduce(words, axis=1).reshape(height, width, -1)
    return (np.bitwise_or.reduce(words, axis=2) != 0).astype(np.uint8)


def content_boxes(blocks: np.ndarray, reach_px: float) -> list[tuple[slice, slice]]:
    """Disjoint boxes (rows, columns) that hold every pixel within `reach_px` of a mask, at multiples of BLOCK_PX.

    Args:
        blocks: occupied_blocks of the mask.
        reach_px: how far from the mask the distance is needed.
    """
    grow = int(np.ceil(reach_px / BLOCK_PX))
    blocks = cv2.dilate(blocks, np.ones((2 * grow + 1, 2 * grow + 1), np.uint8))
    while True:
        _, _, stats, _ = cv2.connectedComponentsWithStats(blocks, connectivity=8)
        covered = blocks.copy()
        for x, y, w, h, _ in stats[1:]:
            covered[y : y + h, x : x + w] = 1
        if np.array_equal(covered, blocks):
            break
        blocks = covered
    b = BLOCK_PX
    return [(slice(y * b, (y + h) * b), slice(x * b, (x + w) * b)) for x, y, w, h, _ in stats[1:].tolist()]


def _thin(binary: np.ndarray, blur: float) -> np.ndarray | None:
    """Where the mask or a gap in it is too thin to survive the smoothing, 0 or 255; None if nowhere."""
    size = max(2, round(2.0 * blur))
    square = np.ones((size, size), np.uint8)
    opened = cv2.morphologyEx(binary, cv2.MORPH_OPEN, square)
    closed = cv2.morphologyEx(binary, cv2.MORPH_CLOSE, square, borderType=cv2.BORDER_REPLICATE)
    lost = cv2.compare(opened, closed, cv2.CMP_NE)
    if not cv2.countNonZero(lost):
        return None
    return cv2.dilate(lost, np.ones((3, 3), np.uint8))


@lru_cache
def _half_pixel(half: float, outset: float) -> np.ndarray:
    table = np.full(256, -half - outset, np.float32)
    table[0] = half - outset
    return table


@lru_cache
def _edge_tables(sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Weight of the plain distance and the weighted edge distance [px] for each 8-bit level of the smoothed mask."""
    level = np.clip(np.arange(256) / 255.0, 0.5 / 255.0, 1.0 - 0.5 / 255.0)
    edge = np.array([-sigma * NormalDist().inv_cdf(value) for value in level])
    fade = np.clip((np.abs(edge) / sigma - 0.8) / 1.2, 0.0, 1.0)
    keep = fade * fade * (3.0 - 2.0 * fade)
    return keep.astype(np.float32), ((1.0 - keep) * edge).astype(np.float32)
