"""Where the vehicle may be and where it is, as a small plan in the corner of a picture (room: viz).

In: errors, standard deviations, protection levels and alert limits of one frame. Out: an image with the plan in it.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.viz.style import PLAN_BACK, PLAN_INK, rgb

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
