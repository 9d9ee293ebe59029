"""What a mask shows as contours, each with a class and a confidence (room: perception; host).

In: class ids of one camera, their class table. Out: SemanticFeature list in pixels.
As the light semantic localizer does it: closing, contours, those of at least 50 px, a type and a confidence for each.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.perception.class_table import ClassTable
from semloc_jax.perception.surround import PAINT

_RIM_PX = 2
"""A contour this near to what hides the road is the border of that, not of paint; ours."""


@dataclass(frozen=True)
class FeatureConfig:
    """What is a feature."""

    min_area_px: float = 50.0
    """Area inside of a contour; the article's."""
    close_px: int = 3
    """Side of the square that the closing takes; ours."""


@dataclass(frozen=True)
class SemanticFeature:
    """One contour on the road.

    Attributes:
        channel: its type: index of the channel of the class table.
        uv: places along the contour [px].
        confidence: share of what the contour encloses that the mask shows before the closing, 0 to 1.
    """

    channel: int
    uv: Float[np.ndarray, "n 2"]
    confidence: float


def mask_features(
    mask: UInt8[np.ndarray, "h w"], table: ClassTable, config: FeatureConfig | None = None
) -> list[SemanticFeature]:
    """The features of one mask, those on the road alone: what stands upright has no place in a top view.

    Args:
        mask: class ids.
        table: what they mean.
        config: None for the defaults.
    """
    config = config or FeatureConfig()
    hidden = np.isin(mask, table.unusable_ids).astype(np.uint8)
    near_hidden = cv2.dilate(hidden, np.ones((2 * _RIM_PX + 1, 2 * _RIM_PX + 1), np.uint8)) > 0
    near_hidden[[0, -1], :] = near_hidden[:, [0, -1]] = True
    found = []
    for index, channel in enumerate(table.channels):
        if not set(channel.classes) & PAINT:
            continue
        shown = np.isin(mask, channel.mask_ids).astype(np.uint8)
        if shown.any():
            found += _contours(shown, near_hidden, index, config)
    return found


def _contours(
    shown: UInt8[np.ndarray, "h w"], near_hidden: Bool[np.ndarray, "h w"], index: int, config: FeatureConfig
) -> list[SemanticFeature]:
    closed = cv2.morphologyEx(shown, cv2.MORPH_CLOSE, np.ones((config.close_px, config.close_px), np.uint8))
    # Holes count, too: slots that touch make one outline with a hole for each of them.
    contours, tree = cv2.findContours(closed, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    found = []
    for contour, (_, _, _, parent) in zip(contours, [] if tree is None else tree[0], strict=True):
        if cv2.contourArea(contour) < config.min_area_px:
            continue
        uv = contour[:, 0]
        own = uv[~near_hidden[uv[:, 1], uv[:, 0]]]
        if len(own):
            found.append(SemanticFeature(index, own.astype(np.float64), _confidence(shown, contour, bool(parent >= 0))))
    return found


def _confidence(shown: UInt8[np.ndarray, "h w"], contour: np.ndarray, is_hole: bool) -> float:
    low, high = contour[:, 0].min(axis=0), contour[:, 0].max(axis=0) + 1
    inside = np.zeros((high - low)[::-1], np.uint8)
    # The contour of a hole runs on the paint around it.
    cv2.drawContours(inside, [contour - low], -1, 1, thickness=1 if is_hole else cv2.FILLED)
    return float(shown[low[1] : high[1], low[0] : high[0]][inside > 0].mean())
