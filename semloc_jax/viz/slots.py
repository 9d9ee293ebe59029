"""Parking slots and marking points drawn on a top view (room: viz).

In: a top view, slots in the base frame or points found and true ones. Out: image arrays.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from semloc_jax.perception.networks.marking_net import MarkingPoints
from semloc_jax.viz.style import SHIFT, rgb

FREE, TAKEN, UNSURE = "#00e676", "#ff5252", "#90a4ae"


class DrawnSlot(NamedTuple):
    """What is drawn of one slot."""

    corners_base: np.ndarray
    """float64[4 2]: both ends of the entrance, then the back [m]."""
    name: str
    occupied: bool | None
    confirmed: bool


def colour_of(occupied: bool | None) -> str:
    """Colour of a confirmed slot."""
    return TAKEN if occupied else FREE


def draw_slots(
    picture: np.ndarray, pixels: Callable[[np.ndarray], np.ndarray], slots: Sequence[DrawnSlot]
) -> np.ndarray:
    """A copy of a top view, uint8[h w 3] red green blue, with slots: free green, taken red, not confirmed grey.

    Args:
        picture: the top view.
        pixels: of places [n 2] of its base frame in it.
        slots: what is drawn.
    """
    shown = np.ascontiguousarray(picture).copy()
    thick = max(1, round(shown.shape[1] / 350))
    for slot in sorted(slots, key=lambda s: s.confirmed):
        uv = pixels(slot.corners_base)
        colour = rgb(colour_of(slot.occupied) if slot.confirmed else UNSURE)
        fixed = np.round(uv * 2**SHIFT).astype(np.int32)
        if slot.confirmed:
            filled = shown.copy()
            cv2.fillPoly(filled, [fixed], colour, cv2.LINE_AA, SHIFT)
            shown = cv2.addWeighted(filled, 0.22, shown, 0.78, 0.0)
        cv2.polylines(shown, [fixed], True, colour, thick, cv2.LINE_AA, SHIFT)
        cv2.polylines(shown, [fixed[:2]], False, (255, 255, 255), thick + 1, cv2.LINE_AA, SHIFT)
        middle = uv.mean(axis=0).round().astype(int)
        size = cv2.getTextSize(slot.name, cv2.FONT_HERSHEY_SIMPLEX, 0.22 * thick, thick)[0]
        at = int(middle[0] - size[0] / 2), int(middle[1] + size[1] / 2)
        for ink, extra in (((8, 10, 14), 2), ((240, 244, 248), 0)):
            cv2.putText(shown, slot.name, at, cv2.FONT_HERSHEY_SIMPLEX, 0.22 * thick, ink, thick + extra, cv2.LINE_AA)
    return shown


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
