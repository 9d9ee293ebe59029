"""Corners to follow, spread over an image (room: perception; host).

In: a grey image, where nothing may be taken, corners that are followed already. Out: corners uv [n 2] [px].
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

_HALF = 2
"""Corners are looked for in the image of half size: four times cheaper, and small noise is gone."""
_BLOCK_PX = 3
_LEAST_SHARE = 0.003
"""A corner is at least so strong, as a share of a strong one (the 99th percentile of the buckets); our choice."""
_LEAST_STRENGTH = 2e-5
"""And so strong at all: a corner of noise of one grey level is weaker; our choice."""


def new_corners(
    grey: UInt8[np.ndarray, "h w"],
    usable: Bool[np.ndarray, "h w"] | None,
    taken_uv: Float[np.ndarray, "n 2"],
    num_wanted: int,
    bucket_px: int,
    border_px: int,
) -> Float[np.ndarray, "m 2"]:
    """At most `num_wanted` corners, the strongest of every bucket without a corner, strong buckets first.

    Args:
        grey: The image.
        usable: False where no corner may be; None for nowhere.
        taken_uv: Corners that are there already [px].
        num_wanted: Most of them.
        bucket_px: Side of a bucket.
        border_px: Distance from the border of the image.
    """
    if num_wanted <= 0:
        return np.zeros((0, 2))
    small = cv2.resize(grey, None, fx=1 / _HALF, fy=1 / _HALF, interpolation=cv2.INTER_AREA)
    strength = cv2.cornerMinEigenVal(small, _BLOCK_PX)
    free = _free(small.shape, usable, taken_uv, bucket_px, border_px)
    uv, best = _best_of_buckets(np.where(free, strength, 0.0), max(bucket_px // _HALF, 2))
    strong = best[best > 0.0]
    least = max(_LEAST_STRENGTH, _LEAST_SHARE * float(np.percentile(strong, 99))) if len(strong) else np.inf
    order = np.argsort(-best, kind="stable")
    order = order[best[order] >= least][:num_wanted]
    # The centre of a pixel of half size lies between four pixels.
    return _HALF * (_refined(strength, uv[order]) + 0.5) - 0.5


def _free(
    shape: tuple[int, int], usable: np.ndarray | None, taken_uv: np.ndarray, bucket_px: int, border_px: int
) -> Bool[np.ndarray, "h w"]:
    """Where a corner may be, in the image of half size."""
    free = np.ones(shape, np.uint8)
    if usable is not None:
        # A corner on the edge of a car moves with the car.
        near = cv2.erode(usable.astype(np.uint8), np.ones((7, 7), np.uint8), borderValue=1)
        free = cv2.resize(near, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    for u, v in np.round((taken_uv + 0.5) / _HALF - 0.5).astype(int).tolist():
        cv2.circle(free, (u, v), max(bucket_px // (2 * _HALF), 1), 0, -1)
    edge = max(border_px // _HALF, 1)
    free[:edge], free[-edge:], free[:, :edge], free[:, -edge:] = 0, 0, 0, 0
    return free.astype(bool)


def _best_of_buckets(strength: np.ndarray, side: int) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Place and strength of the strongest pixel of every bucket."""
    height, width = strength.shape
    rows, columns = -(-height // side), -(-width // side)
    padded = np.zeros((rows * side, columns * side), strength.dtype)
    padded[:height, :width] = strength
    buckets = padded.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows, columns, -1)
    place = buckets.argmax(axis=2)
    v = np.arange(rows)[:, None] * side + place // side
    u = np.arange(columns)[None, :] * side + place % side
    return np.stack([u, v], axis=-1).reshape(-1, 2).astype(float), buckets.max(axis=2).ravel()


def _refined(strength: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """The top of a parabola through the strengths beside each pixel."""
    if not len(uv):
        return uv
    u, v = uv.astype(int).T
    here = strength[v, u].astype(float)
    moved = []
    for before, after in ((strength[v, u - 1], strength[v, u + 1]), (strength[v - 1, u], strength[v + 1, u])):
        bend = before.astype(float) + after - 2.0 * here
        shift = 0.5 * (before.astype(float) - after) / np.where(np.abs(bend) < 1e-12, 1.0, bend)
        moved.append(np.where(np.abs(bend) < 1e-12, 0.0, np.clip(shift, -0.5, 0.5)))
    return uv + np.stack(moved, axis=1)
