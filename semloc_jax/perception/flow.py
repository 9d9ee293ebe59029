"""Where points of one image are in another: pyramidal Lucas-Kanade, there and back (room: perception; host).

In: two grey images, points uv [n 2] [px]. Out: Flow.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

_MOST_STEPS, _LEAST_STEP_PX = 30, 0.005


class FlowConfig(NamedTuple):
    """How points are compared."""

    window_px: int
    """Side of the window."""
    num_levels: int
    """Levels of the pyramid."""
    back_check_px: float
    """A point that is followed there and back returns within this."""
    border_px: int
    """Nearer to the border of the image nothing is found."""


class Flow(NamedTuple):
    """Points in the other image."""

    uv: Float[np.ndarray, "n 2"]
    found: Bool[np.ndarray, " n"]


def is_inside(uv: Float[np.ndarray, "n 2"], shape: tuple[int, ...], border_px: int) -> Bool[np.ndarray, " n"]:
    """Which pixels of an image [h w] lie so far from its border."""
    height, width = shape[:2]
    return (uv >= border_px).all(axis=1) & (uv < np.array([width, height]) - border_px).all(axis=1)


def followed(
    before: UInt8[np.ndarray, "h w"],
    now: UInt8[np.ndarray, "h w"],
    uv: Float[np.ndarray, "n 2"],
    config: FlowConfig,
) -> Flow:
    """The points in the later image; the search begins where they were."""
    if not len(uv):
        return Flow(np.zeros((0, 2)), np.zeros(0, bool))
    old = np.asarray(uv, np.float32)
    options = {
        "winSize": (config.window_px, config.window_px),
        "maxLevel": config.num_levels - 1,
        "criteria": (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _MOST_STEPS, _LEAST_STEP_PX),
    }
    new, ahead, _ = cv2.calcOpticalFlowPyrLK(before, now, old, None, **options)
    back, behind, _ = cv2.calcOpticalFlowPyrLK(
        now, before, new, old.copy(), flags=cv2.OPTFLOW_USE_INITIAL_FLOW, **options
    )
    good = (ahead[:, 0] > 0) & (behind[:, 0] > 0) & is_inside(new, now.shape, config.border_px)
    good &= np.linalg.norm(back - old, axis=1) < config.back_check_px
    return Flow(new, good)
