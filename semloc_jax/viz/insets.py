"""Small plans in the corner of a picture: where the vehicle may be and where it is, a map that grows (room: viz).

In: errors, sigmas, protection levels and limits of a frame; elements of a map and when each was first seen. Out: an
image with the plan in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.maps.elements import MapElement
from semloc_jax.viz.maps import outline
from semloc_jax.viz.style import COLOURS, ESTIMATE, PLAN_BACK, PLAN_INK, SHIFT, rgb

_LIMIT, _LEVEL, _SIGMA, _REFERENCE = "#ef5350", "#90caf9", "#ffffff", "#66bb6a"
_SIGMAS = 3.0
_REACH = 1.6
"""Half width of the plan in alert limits; what is farther stands at its border."""


@dataclass(frozen=True)
class FrameErrors:
    """Lateral and longitudinal, in this order; not finite where nothing is known.

    Args:
        error_m: Estimate from the reference, + to the left and ahead.
        sigma_m: Standard deviations.
        level_m: Protection levels.
        limit_m: Alert limits.
    """

    error_m: tuple[float, float]
    sigma_m: tuple[float, float]
    level_m: tuple[float, float]
    limit_m: tuple[float, float]


def with_inset(image: np.ndarray, errors: FrameErrors) -> np.ndarray:
    """A copy of an RGB image with a plan in its upper right corner: the estimate in the middle, ahead is up.

    Alert limits are a red box, protection levels a blue box, three standard deviations a white ellipse, the reference
    a green cross.

    Args:
        image: uint8[h w 3].
        errors: Of the frame.
    """
    size = int(np.clip(0.42 * image.shape[0], 96, 260))
    plan = np.full((size, size, 3), PLAN_BACK, np.uint8)
    reach_m, middle = _REACH * max(errors.limit_m), 0.5 * size
    scale = middle / reach_m

    def half_px(lengths_m: tuple[float, float]) -> np.ndarray:
        lengths = np.abs(np.where(np.isfinite(lengths_m), lengths_m, reach_m))
        return np.minimum(lengths * scale, middle - 2.0)

    def box(lengths_m: tuple[float, float], colour: str, thickness_px: int) -> None:
        across, along = half_px(lengths_m)
        corners = [(round(middle + sign * across), round(middle + sign * along)) for sign in (-1, 1)]
        cv2.rectangle(plan, *corners, rgb(colour), thickness_px, cv2.LINE_AA)

    box(errors.limit_m, _LIMIT, 1)
    box(errors.level_m, _LEVEL, 2)
    axes = tuple(int(max(length, 1)) for length in half_px(tuple(_SIGMAS * s for s in errors.sigma_m)))
    cv2.ellipse(plan, (round(middle), round(middle)), axes, 0, 0, 360, rgb(_SIGMA), 1, cv2.LINE_AA)
    if np.isfinite(errors.error_m).all():
        # The reference as seen from the estimate: left is to the left of the picture.
        across, along = np.clip(np.multiply(errors.error_m, scale), 4.0 - middle, middle - 4.0)
        centre = (round(middle + across), round(middle + along))
        cv2.drawMarker(plan, centre, rgb(_REFERENCE), cv2.MARKER_CROSS, 13, 2, cv2.LINE_AA)
    text = f"{2 * reach_m:.1f} m"
    cv2.putText(plan, text, (5, size - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.36, PLAN_INK, 1, cv2.LINE_AA)
    picture, edge = image.copy(), max(size // 24, 4)
    picture[edge : edge + size, image.shape[1] - edge - size : image.shape[1] - edge] = plan
    return picture


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
