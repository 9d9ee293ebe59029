"""Where a top view of the road is brighter than its surroundings by as much as paint (room: perception; host).

In: the top view of one image. Out: PaintCandidates, still with bumpers, wheels and kerb stones among them.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.perception.point_groups import extremes

_YELLOW_GAIN = 0.7
_PIECE_M = 2.5


@dataclass(frozen=True)
class PaintConfig:
    """What counts as paint on the road; lengths on the road plane."""

    metres_per_px: float = 0.05
    """Pixel of the top view in which paint is looked for [m]."""
    range_m: float = 35.0
    """How far from the camera [m]."""
    max_width_m: float = 0.6
    """Widest stroke: stop lines and crosswalk bars [m]."""
    min_area_m2: float = 0.015
    contrast: float = 0.18
    """Least excess of brightness over the road, as a share of the road's brightness."""
    excess_sigma: float = 4.0
    """Least excess of brightness in standard deviations of the road's texture."""

    def __post_init__(self) -> None:
        if not 0.01 <= self.metres_per_px <= 0.2 or self.range_m <= 2.0 or self.max_width_m <= 0.0:
            raise SemlocError(f"paint: metres_per_px must lie in 0.01...0.2, range and width be positive; got {self}")

    def disk(self, diameter_m: float) -> np.ndarray:
        """Structuring element: a disk on the road."""
        radius = max(round(diameter_m / self.metres_per_px / 2), 1)
        return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


@dataclass(frozen=True)
class PaintCandidates:
    """Bright narrow spots of a top view, all arrays [h w]."""

    grey: np.ndarray
    """Brightness in which white and yellow both stand out, float32."""
    background: np.ndarray
    """Brightness of the road under and around each spot, float32."""
    visible: np.ndarray
    """Pixels that count, bool."""
    label: np.ndarray
    """Number of the spot, 0 for none, int32."""
    boxes: dict[int, tuple[slice, slice]]
    """Rows and columns of each spot with a bright enough core and enough area, by number."""


def find_candidates(top: np.ndarray, visible: np.ndarray, config: PaintConfig) -> PaintCandidates:
    """Spots narrower than a stroke of paint and brighter than the road around them.

    The road's brightness is the morphological opening of the view: it removes all that is narrower than its disk
    (white top-hat). The excess is judged against the road's texture near by and, as shadows scale both, by its ratio.

    Args:
        top: top view, uint8[h w 3] BGR.
        visible: what the camera sees of the road, bool[h w].
    """
    grey = paint_brightness(top)
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.8)
    disk = config.disk(config.max_width_m + 0.2)
    lowest = cv2.erode(np.where(visible, smooth, np.float32(255)), disk)
    background = cv2.dilate(np.where(visible, lowest, np.float32(0)), disk)
    background = cv2.GaussianBlur(background, (0, 0), 0.2 / config.metres_per_px)
    excess = np.where(visible, smooth - background, np.float32(0))
    mean, sigma = _texture(np.minimum(excess, 0.2 * background + 5.0), visible, 1.0 / config.metres_per_px)
    rise, ratio = (excess - mean) / (sigma + 1.0), excess / (background + 8.0)
    inner = cv2.erode(visible.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    strong = inner & (rise > config.excess_sigma) & (ratio > config.contrast)
    weak = inner & (rise > 0.5 * config.excess_sigma) & (ratio > 0.6 * config.contrast)
    label, boxes = _pieces(weak, strong, config)
    return PaintCandidates(grey, background, visible, label, boxes)


def _pieces(
    weak: np.ndarray, strong: np.ndarray, config: PaintConfig
) -> tuple[np.ndarray, dict[int, tuple[slice, slice]]]:
    """Numbers of the weak spots that are large and have a strong core, and their boxes.

    Long ones are cut at a grid: a lane line may cross a joint, a shadow or meet the bonnet.
    """
    count, parent = cv2.connectedComponents(weak.astype(np.uint8), connectivity=8)
    v, u = np.nonzero(weak)
    keep = np.bincount(parent[v, u], minlength=count) * config.metres_per_px**2 >= config.min_area_m2
    keep &= np.bincount(parent[v, u], weights=strong[v, u], minlength=count) >= 2
    v, u = v[keep[parent[v, u]]], u[keep[parent[v, u]]]
    size_px = round(_PIECE_M / config.metres_per_px)
    cell = (v // size_px).astype(np.int64) * (weak.shape[1] // size_px + 1) + u // size_px
    _, number = np.unique(cell * count + parent[v, u], return_inverse=True)
    label = np.zeros(weak.shape, np.int32)
    label[v, u] = number + 1
    sides = (zip(*(extreme.tolist() for extreme in extremes(side, number)), strict=True) for side in (v, u))
    boxes = (
        (slice(top, bottom + 1), slice(left, right + 1)) for (top, bottom), (left, right) in zip(*sides, strict=True)
    )
    return label, dict(enumerate(boxes, start=1))


def paint_brightness(image: np.ndarray) -> np.ndarray:
    """Mean of red and green, raised where only blue lacks: on light concrete yellow paint is no brighter than the road.

    Args:
        image: BGR, uint8[h w 3].
    """
    blue, green, red = cv2.split(image)
    brightness = cv2.add(green, red, dtype=cv2.CV_32F)
    brightness *= np.float32(0.5)
    # Bytes do not fall below 0: no lack of blue counts as none.
    yellow = cv2.subtract(cv2.min(green, red), blue).astype(np.float32)
    yellow *= np.float32(_YELLOW_GAIN)
    brightness += yellow
    return brightness


def _texture(excess: np.ndarray, visible: np.ndarray, sigma_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of the excess around each pixel, over visible pixels only."""
    # Blurred at a quarter of the size: the window is large and smooth.
    size, small = excess.shape[::-1], (max(excess.shape[1] // 4, 1), max(excess.shape[0] // 4, 1))

    def blur(values: np.ndarray) -> np.ndarray:
        coarse = cv2.resize(values, small, interpolation=cv2.INTER_AREA)
        return cv2.GaussianBlur(coarse, (0, 0), sigma_px / 4)

    weight = visible.astype(np.float32)
    total = np.maximum(blur(weight), 1e-3)
    mean = blur(excess * weight) / total
    spread = np.sqrt(np.maximum(blur(excess * excess * weight) / total - mean * mean, 0.0))
    return cv2.resize(mean, size), cv2.resize(spread, size)
