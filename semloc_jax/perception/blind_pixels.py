"""Pixels of a camera that never show the world: outside of the image circle, or the own car (room: perception; host).

In: pictures of one camera over a drive. Out: which pixels are blind.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

_DARK = 10
"""Grey levels up to which a pixel may just be the black around the image circle."""
_LEAST_SHARE = 2e-4
"""Of the picture; smaller specks are noise of a dark scene."""


def blind_pixels(images: Sequence[UInt8[np.ndarray, "h w 3"]]) -> Bool[np.ndarray, "h w"]:
    """Pixels that are black in all pictures of a camera, in pieces that touch the border of the picture.

    Args:
        images: of one camera, of one size; a few that lie apart in time are enough.
    """
    brightest = np.maximum.reduce([image.max(axis=2) for image in images])
    num, labels, stats, _ = cv2.connectedComponentsWithStats((brightest <= _DARK).astype(np.uint8), connectivity=4)
    rim = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    large = [k for k in rim if k > 0 and stats[k, cv2.CC_STAT_AREA] >= _LEAST_SHARE * brightest.size]
    blind = np.isin(labels, large) if num > 1 else np.zeros(labels.shape, bool)
    return cv2.dilate(blind.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
