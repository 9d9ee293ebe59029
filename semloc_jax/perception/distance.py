"""Signed distance to the boundary of a binary mask with sub-pixel accuracy (room: perception; host).

In: one binary layer of a mask. Out: float32 distance in pixels, negative inside, and the boxes where it matters.
"""

from functools import lru_cache
from statistics import NormalDist

import cv2
import numpy as np

BLOCK_PX = 16
"""Boxes begin and end at multiples of this; every pyramid stride divides it."""


def signed_distance(binary: np.ndarray, blur_px: float) -> np.ndarray:
    """Signed distance [px] of every pixel centre to the boundary of a binary mask, float32[h w], negative inside.

    Far from the boundary it is the Euclidean distance to the nearest pixel of the other side less half a pixel, as the
    boundary lies midway between two centres. Near the boundary that distance is a staircase; there the mask is
    smoothed, and the level of a smoothed straight edge, s = Phi(-d / blur_px), is solved for d.

    Args:
        binary: uint8[h w], 0 outside, 255 inside.
        blur_px: standard deviation of the smoothing; 0 gives the plain distance transform.
    """
    outside = cv2.distanceTransform(cv2.bitwise_not(binary), cv2.DIST_L2, cv2.DIST_MASK_5)
    inside = cv2.distanceTransform(binary, cv2.DIST_L2, cv2.DIST_MASK_5)
    distance = cv2.subtract(outside, inside)
    # One of the two is 0 at every pixel, so the half pixel is taken off by the sign.
    distance = cv2.subtract(distance, cv2.LUT(binary, _half_pixel()))
    if blur_px <= 0:
        return distance
    smooth = cv2.GaussianBlur(binary, (0, 0), blur_px, borderType=cv2.BORDER_REPLICATE)
    keep, add = (cv2.LUT(smooth, table) for table in _edge_tables(blur_px))
    thin = _thin(binary, max(2, round(2.0 * blur_px)))
    if thin is not None:
        keep[thin], add[thin] = 1.0, 0.0
    return cv2.add(cv2.multiply(distance, keep), add)


def content_boxes(binary: np.ndarray, reach_px: float) -> list[tuple[slice, slice]]:
    """Disjoint boxes (rows, columns) that hold every pixel within `reach_px` of the mask, at multiples of BLOCK_PX.

    Args:
        binary: uint8[h w], 0 outside, 255 inside, h and w multiples of BLOCK_PX.
        reach_px: how far from the mask the distance is needed.
    """
    height, width = binary.shape[0] // BLOCK_PX, binary.shape[1] // BLOCK_PX
    blocks = (cv2.resize(binary, (width, height), interpolation=cv2.INTER_AREA) > 0).astype(np.uint8)
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
    return [(slice(y * b, (y + h) * b), slice(x * b, (x + w) * b)) for x, y, w, h, _ in stats[1:]]


def _thin(binary: np.ndarray, size_px: int) -> np.ndarray | None:
    """Where the mask or a gap in it is too thin (less than `size_px`) to survive the smoothing; None if nowhere."""
    square = np.ones((size_px, size_px), np.uint8)
    opened = cv2.morphologyEx(binary, cv2.MORPH_OPEN, square)
    closed = cv2.morphologyEx(binary, cv2.MORPH_CLOSE, square, borderType=cv2.BORDER_REPLICATE)
    lost = cv2.compare(opened, closed, cv2.CMP_NE)
    if not cv2.countNonZero(lost):
        return None
    return cv2.dilate(lost, np.ones((3, 3), np.uint8)) > 0


@lru_cache
def _half_pixel() -> np.ndarray:
    table = np.full(256, -0.5, np.float32)
    table[0] = 0.5
    return table


@lru_cache
def _edge_tables(blur_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Weight of the plain distance and the weighted edge distance [px] for each 8-bit level of the smoothed mask."""
    level = np.clip(np.arange(256) / 255.0, 0.5 / 255.0, 1.0 - 0.5 / 255.0)
    edge = np.array([-blur_px * NormalDist().inv_cdf(value) for value in level])
    fade = np.clip((np.abs(edge) / blur_px - 0.8) / 1.2, 0.0, 1.0)
    keep = fade * fade * (3.0 - 2.0 * fade)
    return keep.astype(np.float32), ((1.0 - keep) * edge).astype(np.float32)
