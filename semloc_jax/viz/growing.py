"""A map that grows, as a plan in the corner of a picture (room: viz).

In: elements of a map, when each was first seen, places of the vehicle. Out: an image with the plan in it.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.maps.elements import MapElement
from semloc_jax.viz.maps import outline
from semloc_jax.viz.style import COLOURS, ESTIMATE, PLAN_BACK, PLAN_INK, SHIFT, rgb

_NEW = "#ffffff"
_POST_PX = 2.5
_SHARE = 0.36
"""Of the height of a picture that its plan may have, and of its width."""
_SPAN_M = 60.0
"""A larger map is shown around the vehicle, in a plan of this width."""


class GrowingPlan:
    """Draws what is known of a map by a time; north is up, the way of the vehicle white."""

    def __init__(self, elements: Sequence[MapElement], way_xy: Float[np.ndarray, "n 2"]):
        """Outlines are made once; the way says what the plan has to hold."""
        self._outlines = [outline(element) for element in elements]
        self._labels = [element.label for element in elements]
        self._way = np.asarray(way_xy, np.float64)
        held = np.vstack([self._way, *self._outlines])
        self._middle, self._span_m = 0.5 * (held.min(axis=0) + held.max(axis=0)), np.ptp(held, axis=0) + 4.0

    def inset(
        self,
        image: UInt8[np.ndarray, "h w 3"],
        is_known: Bool[np.ndarray, " m"],
        is_new: Bool[np.ndarray, " m"],
        row: int,
    ) -> UInt8[np.ndarray, "h w 3"]:
        """A copy of an RGB image with the plan in its upper right corner.

        Args:
            image: the picture.
            is_known: elements that were seen by now.
            is_new: those that were seen just now; drawn white.
            row: place of the vehicle on its way.
        """
        span_m = np.minimum(self._span_m, _SPAN_M)
        scale = min(_SHARE * image.shape[0] / span_m[1], _SHARE * image.shape[1] / span_m[0])
        width, height = (round(float(length)) for length in np.maximum(scale * span_m, 48.0))
        plan = np.full((height, width, 3), PLAN_BACK, np.uint8)
        here = np.where(self._span_m > _SPAN_M, self._way[row], self._middle)

        def px(xy: np.ndarray) -> np.ndarray:
            off = (xy - here) * [scale, -scale] + [0.5 * width, 0.5 * height]
            return np.round(np.clip(off, -1e4, 1e4) * 2**SHIFT).astype(np.int32)

        for k in np.flatnonzero(is_known):
            colour = rgb(_NEW if is_new[k] else COLOURS[self._labels[k]])
            line = self._outlines[k]
            if np.ptp(line, axis=0).max() * scale < _POST_PX:
                cv2.circle(plan, px(line[0]), round(_POST_PX * 2**SHIFT), colour, 1, cv2.LINE_AA, SHIFT)
            else:
                cv2.polylines(plan, [px(line)], False, colour, 1, cv2.LINE_AA, SHIFT)
        cv2.polylines(plan, [px(self._way[: row + 1])], False, rgb(ESTIMATE), 1, cv2.LINE_AA, SHIFT)
        cv2.circle(plan, px(self._way[row]), 4 * 2**SHIFT, rgb(ESTIMATE), -1, cv2.LINE_AA, SHIFT)
        text = f"{span_m[0]:.0f} m"
        cv2.putText(plan, text, (5, height - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.36, PLAN_INK, 1, cv2.LINE_AA)
        picture, edge = image.copy(), max(image.shape[0] // 50, 4)
        picture[edge : edge + height, image.shape[1] - edge - width : image.shape[1] - edge] = plan
        return picture
