"""Corners to follow, spread over an image (room: perception; host).

In: a grey image, where nothing may be taken, corners that are followed already, which way points flow. Out: corners
uv [n 2] [px].
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
_LEAST_ALONG = 0.2
"""Slope along the flow that the surroundings of a corner have at least, as a share of the slope across it."""
_AROUND_PX = 20
"""Side of these surroundings: of what is compared when a corner is followed (`patches`), not of the corner alone."""


def new_corners(
    grey: UInt8[np.ndarray, "h w"],
    usable: Bool[np.ndarray, "h w"] | None,
    taken_uv: Float[np.ndarray, "n 2"],
    num_wanted: int,
    bucket_px: int,
    border_px: int,
    flow: Float[np.ndarray, "a b 2"] | None = None,
) -> Float[np.ndarray, "m 2"]:
    """At most `num_wanted` corners, the strongest of every bucket without a corner, strong buckets first.

    Args:
        grey: The image.
        usable: False where no corner may be; None for nowhere.
        taken_uv: Corners that are there already [px].
        num_wanted: Most of them.
        bucket_px: Side of a bucket.
        border_px: Distance from the border of the image.
        flow: Which way points move in the image as the camera goes on, of any length and sign, on a grid of its evenly
            divided fields; None where that is not known.
    """
    if num_wanted <= 0:
        return np.zeros((0, 2))
    small = cv2.resize(grey, None, fx=1 / _HALF, fy=1 / _HALF, interpolation=cv2.INTER_AREA)
    strength = cv2.cornerMinEigenVal(small, _BLOCK_PX)
    free = _free(small.shape, usable, taken_uv, bucket_px, border_px)
    if flow is not None:
        free &= _tells_its_way(small, flow)
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


def _tells_its_way(small: UInt8[np.ndarray, "h w"], flow: Float[np.ndarray, "a b 2"]) -> Bool[np.ndarray, "h w"]:
    """Where an image shows how far a point has moved along its flow.

    An edge that leads the way the points go, as of a lane marking ahead, looks the same all along; what little differs
    along it, its width and its stairs, stays where it is in the image while the road goes by. Followed, it seems far
    away. What is known along the flow while the shift across it is unknown, too, is compared with the slope across it.
    """
    du, dv = (cv2.Sobel(small, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    shape = small.shape[0] // _HALF, small.shape[1] // _HALF
    side = _AROUND_PX // _HALF**2
    squares = (cv2.resize(a * b, shape[::-1], interpolation=cv2.INTER_AREA) for a, b in ((du, du), (du, dv), (dv, dv)))
    uu, uv, vv = (cv2.boxFilter(square, -1, (side, side)) for square in squares)
    u, v = cv2.split(cv2.resize(flow.astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR))
    across = v * v * uu - 2.0 * u * v * uv + u * u * vv
    tells = (uu * vv - uv * uv) * (u * u + v * v) ** 2 >= _LEAST_ALONG**2 * across**2
    return cv2.resize(tells.view(np.uint8), small.shape[::-1], interpolation=cv2.INTER_NEAREST).view(bool)


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
