"""Parking slots drawn on a top view (room: viz).

In: a top view, slots in the base frame. Out: image arrays.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

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
