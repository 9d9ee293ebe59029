"""Marks on the road as connected pieces of a top view (room: perception; host).

In: a binary or grey top view and its cell size. Out: RoadMark list: cells, size, whether it was seen whole; features.
Road-SLAM (Jeong, Cho, Kim, IV 2017): binarise the top view, connected components, ESF-640 of each. The descriptor drops
scale and heading, so length, width, area and the turn against the driving direction are appended.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.perception.shape_functions import ShapeConfig, shape_functions

CELL_M = 0.05
"""Side of the cells of the top view: Road-SLAM's marks are some ten cells wide."""
_STROKE_M = 0.6
"""Paint is narrower than this: what a top-hat lets pass."""
_LEAST_CONTRAST = 12
"""Grey levels by which paint is brighter than the road around it; ours."""


@dataclass(frozen=True)
class MarkConfig:
    """Which pieces of a top view are marks."""

    min_cells: int = 50
    """Smaller pieces are noise; the literature's."""
    max_length_m: float = 8.0
    """Longer pieces are lines or nets of lines, no marks; ours."""
    shape: ShapeConfig = field(default_factory=lambda: ShapeConfig(num_triples=2_000))
    """A tenth of the paper's triples: marks of some hundred cells have no more to tell; ours."""


@dataclass(frozen=True)
class RoadMark:
    """One piece of paint.

    Attributes:
        xy: its cells [m], x along the driving direction.
        is_whole: whether nothing hides a part of it and the view does not cut it.
        size_m: length and width of the smallest rectangle around it.
        turn_rad: angle of its long side against x, 0 to pi / 2.
    """

    xy: Float[np.ndarray, "n 2"]
    is_whole: bool
    size_m: tuple[float, float]
    turn_rad: float

    @classmethod
    def of(cls, xy: Float[np.ndarray, "n 2"], is_whole: bool = True) -> "RoadMark":
        """The mark of some cells [m]."""
        _, (width, height), degrees = cv2.minAreaRect(np.asarray(xy, np.float32))
        turn = np.deg2rad(degrees if width >= height else degrees + 90.0)
        turn = abs(float(np.arctan2(np.sin(turn), np.cos(turn))))
        long_m, short_m = max(width, height) + CELL_M, min(width, height) + CELL_M
        return cls(np.asarray(xy, np.float64), is_whole, (long_m, short_m), min(turn, np.pi - turn))

    @property
    def middle(self) -> Float[np.ndarray, " 2"]:
        """Middle of its cells [m]."""
        return self.xy.mean(axis=0)

    def features(self, config: ShapeConfig) -> Float[np.ndarray, " 644"]:
        """ESF-640, then length, width [m], area [m^2] and turn [rad]."""
        own = len(self.xy) * CELL_M**2, self.turn_rad
        return np.concatenate([shape_functions(self.xy, CELL_M, config), self.size_m, own])


def marks_of(
    paint: Bool[np.ndarray, "h w"],
    visible: Bool[np.ndarray, "h w"],
    xy: Float[np.ndarray, "h w 2"],
    config: MarkConfig | None = None,
) -> list[RoadMark]:
    """The connected pieces of paint in a top view, the small ones left out.

    Args:
        paint: where the top view shows paint.
        visible: where it shows the road at all; pieces at its border were not seen whole.
        xy: place of every cell [m].
        config: None for the defaults.
    """
    config = config or MarkConfig()
    beside = cv2.dilate((~visible).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    beside[[0, -1], :] = beside[:, [0, -1]] = True
    num, label, stats, _ = cv2.connectedComponentsWithStats((paint & visible).astype(np.uint8), connectivity=8)
    found = []
    for number in range(1, num):
        x, y, width, height, cells = stats[number]
        if cells < config.min_cells:
            continue
        here = slice(y, y + height), slice(x, x + width)
        own = label[here] == number
        mark = RoadMark.of(xy[here][own], not bool(beside[here][own].any()))
        found.append(mark)
    return found


def binarised(grey: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Where a grey top view shows paint: brighter than the road around it, and no broader than paint is.

    A top-hat takes away all that is broad, an adaptive threshold what shade and headlights do.
    """
    size = round(_STROKE_M / CELL_M) | 1
    narrow = cv2.morphologyEx(grey, cv2.MORPH_TOPHAT, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    around = cv2.adaptiveThreshold(
        grey, 1, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, 2 * size + 1, -0.5 * _LEAST_CONTRAST
    )
    return (narrow >= _LEAST_CONTRAST) & (around > 0)
