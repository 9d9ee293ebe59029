"""Marking points drawn on a top view (room: viz).

In: a top view, points found and true ones. Out: image arrays.
"""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from semloc_jax.perception.networks.marking_net import MarkingPoints
from semloc_jax.viz.style import SHIFT, rgb

FOUND, CORNER, TRUE = "#00e676", "#ffd600", "#ff4fa3"
_ENLARGED, _ARROW_M = 2, 0.8


def draw_points(
    picture: UInt8[np.ndarray, "h w 3"],
    metres_per_px: float,
    found: MarkingPoints,
    true_uv_m: Float[np.ndarray, "n 2"],
) -> UInt8[np.ndarray, "i j 3"]:
    """The top view twice as large, red green blue: arrows into the slot, T green and L yellow; rings are the truth.

    Args:
        picture: blue green red.
        metres_per_px: of its pixels.
        found: what is drawn.
        true_uv_m: from the upper left corner [m].
    """
    size = picture.shape[1] * _ENLARGED, picture.shape[0] * _ENLARGED
    shown = np.ascontiguousarray(cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC)[..., ::-1])
    scale = _ENLARGED * 2**SHIFT
    for place in true_uv_m / metres_per_px:
        at = np.rint(place * scale - 2 ** (SHIFT - 1)).astype(int)
        cv2.circle(shown, tuple(at.tolist()), 6 * 2**SHIFT, rgb(TRUE), 1, cv2.LINE_AA, SHIFT)
    for uv, yaw, is_corner in zip(found.uv, found.yaw_rad, found.is_corner, strict=True):
        start = (uv + 0.5) * _ENLARGED
        end = start + _ENLARGED * _ARROW_M / metres_per_px * np.array([np.cos(yaw), np.sin(yaw)])
        colour = rgb(CORNER if is_corner else FOUND)
        a, b = (tuple(np.rint(place).astype(int).tolist()) for place in (start, end))
        cv2.arrowedLine(shown, a, b, colour, 1, cv2.LINE_AA, tipLength=0.3)
        cv2.circle(shown, a, 2, colour, -1, cv2.LINE_AA)
    return shown
