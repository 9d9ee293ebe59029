"""Colours by their mean and spread around each pixel: light, exposure and colour casts drop out (room: perception;
host).

In: a picture. Out: the same, about -1 ... 1, whatever lit it. What a network would have to learn otherwise.
"""

import cv2
import numpy as np
from jaxtyping import Float

_LEAST_SPREAD = 0.03


def levelled(x: Float[np.ndarray, "h w 3"], side_px: int) -> Float[np.ndarray, "h w 3"]:
    """The picture levelled, float32 in -1 ... 1.

    Args:
        x: red, green and blue, float32 in 0 ... 1.
        side_px: of the square around a pixel, odd.
    """
    mean = cv2.blur(x, (side_px, side_px), borderType=cv2.BORDER_REFLECT_101)
    square = cv2.blur(x * x, (side_px, side_px), borderType=cv2.BORDER_REFLECT_101)
    # One spread for all colours: what is grey stays grey.
    spread = np.sqrt(np.maximum((square - mean * mean).mean(axis=-1, keepdims=True), 0.0))
    return np.clip((x - mean) / (3.0 * (spread + np.float32(_LEAST_SPREAD))), -1.0, 1.0)
