"""How much each camera counts at each pixel of a top view (room: perception; host).

In: which cameras see a pixel and which one sees it best. Out: weights that sum to one.
"""

from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.special import ndtr

Blend = Literal["gaussian", "linear", "hard"]
"""How pictures meet at a seam: normal distribution over the signed distance to it, a ramp, or a cut."""

SEAM_SIGMA_M = 0.25
"""Standard deviation of the gaussian blend on the road; the ramp of the linear one is as steep in the middle."""


def seam_weights(
    seen: Bool[np.ndarray, "n h w"], best: Int[np.ndarray, "h w"], blend: Blend, sigma_px: float
) -> Float[np.ndarray, "n h w"]:
    """Weight of each camera, 0 where it sees nothing; they sum to one where any camera sees the road.

    The seam is where the best camera changes. Where a camera's own view ends inside that of another one, its weight
    falls to zero over two sigmas, so that this border does not show either.

    Args:
        seen: whether a camera sees a pixel.
        best: the camera that sees it best.
        blend: how pictures meet.
        sigma_px: standard deviation of the gaussian blend [px].
    """
    weights = np.zeros(seen.shape, np.float32)
    for camera, own in enumerate(seen):
        inside = own & (best == camera)
        if blend == "hard" or not inside.any():
            weights[camera] = inside
            continue
        signed = _distance(inside) - _distance(~inside)
        if blend == "gaussian":
            weight = ndtr(signed / sigma_px)
        else:
            weight = np.clip(0.5 + signed / (np.sqrt(2.0 * np.pi) * sigma_px), 0.0, 1.0)
        weights[camera] = weight * np.clip(_distance(own) / (2.0 * sigma_px), 0.0, 1.0)
    total = weights.sum(axis=0)
    # Far from its own seam a lone camera may have next to no weight: it still shows the pixel alone.
    lone = (total < 1e-6) & seen.any(axis=0)
    for camera in range(len(weights)):
        weights[camera][lone & (best == camera)] = 1.0
    return weights / np.maximum(np.where(lone, 1.0, total), 1e-6)


def strongest_two(weights: Float[np.ndarray, "n h w"]) -> tuple[Shaped[np.ndarray, "2 h w"], Float[np.ndarray, "h w"]]:
    """The two cameras that count most at each pixel, and the share of the second one, 0 ... 0.5.

    A third camera counts nowhere near a car: its weight goes to these two.
    """
    if len(weights) == 1:
        return np.zeros((2, *weights.shape[1:]), np.intp), np.zeros(weights.shape[1:], np.float32)
    pair = np.argsort(-weights, axis=0, kind="stable")[:2]
    first, second = np.take_along_axis(weights, pair, axis=0)
    return pair, (second / np.maximum(first + second, 1e-6)).astype(np.float32)


def _distance(inside: np.ndarray) -> np.ndarray:
    """Distance to the nearest pixel outside [px], measured to the border between the two."""
    if inside.all():
        return np.full(inside.shape, 1e6)
    return np.maximum(cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) - 0.5, 0.0)
