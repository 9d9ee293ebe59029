"""White delineator posts that stand beside a road, without a network (room: perception; host).

In: an image and the ground view of its camera. Out: upright bright bars of the width and height of such posts.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.perception.ground_view import GroundView
from semloc_jax.perception.paint_colours import whiteness
from semloc_jax.perception.paint_profiles import log_brightness
from semloc_jax.perception.point_groups import extremes

_WIDTHS_PX = (1, 2, 3, 5, 8, 12)


@dataclass(frozen=True)
class PostConfig:
    """What a post is like; metres at the place where its foot meets the road plane."""

    min_width_m: float = 0.06
    max_width_m: float = 0.25
    min_height_m: float = 0.45
    max_height_m: float = 1.5
    min_contrast: float = 0.25
    """Of the brighter side's difference of the logarithm of the least of the three colours."""
    min_texture: float = 2.5
    """The same,  in the root mean square of the differences between neighbouring pixels around."""
    min_blue: float = 0.7
    """Least blue, as a share of green and of red, in what a post has more of than what is beside it."""
    gap_m: float = 0.35
    """The black band with the reflector cuts the white in two."""


_POST = PostConfig()


def find_posts(image: np.ndarray, view: GroundView) -> np.ndarray:
    """Pixels of posts, bool[h w].

    Verticals must be upright in the image within some degrees, as they are for cameras that look ahead.

    Args:
        image: BGR, uint8[h w 3].
        view: ground view of the camera.
    """
    # White has all three colours, grass in the sun lacks blue.
    level = log_brightness(whiteness(image))
    out = np.zeros(level.shape, bool)
    for width in _WIDTHS_PX:
        # A post of this many pixels in width stands where a pixel is this large.
        limits_m = _POST.min_width_m / (width + 1), _POST.max_width_m / width
        first, last = np.searchsorted(view.column_sizes_m, limits_m)
        if first < last:
            bars = _upright_bars(level, width, _POST.min_contrast)
            _draw_posts(out, bars, level, image, view.column_m)
    return out


def _upright_bars(level: np.ndarray, width: int, min_contrast: float) -> np.ndarray:
    """Pixels in the middle of bars that are brighter than both sides, uint8[h w]."""
    mean = cv2.blur(level, (width, 1), borderType=cv2.BORDER_REPLICATE)
    padded = cv2.copyMakeBorder(mean, 0, 0, width + 1, width + 1, cv2.BORDER_REPLICATE)
    left, right = padded[:, : level.shape[1]], padded[:, 2 * (width + 1) :]
    excess = np.maximum(left, right)
    bars = np.subtract(mean, excess, out=excess) > min_contrast
    return cv2.morphologyEx(bars.view(np.uint8), cv2.MORPH_OPEN, np.ones((max(2 * width, 3), 1), np.uint8))


def _draw_posts(out: np.ndarray, bars: np.ndarray, level: np.ndarray, image: np.ndarray, lateral_m: np.ndarray) -> None:
    """Adds the posts among bars to `out`."""
    boxes = _boxes(bars)
    boxes = boxes[np.argsort(-(boxes[:, 1] + boxes[:, 3]), kind="stable")]
    columns = np.arange(out.shape[1])
    used = np.zeros(len(boxes), bool)
    for number, box in enumerate(boxes):
        foot = min(int(box[1] + box[3]), level.shape[0] - 1)
        scale = float(lateral_m[foot, min(int(box[0] + box[2] // 2), level.shape[1] - 1)])
        # No bar of three times its height reaches the least height: nothing that is joined to it helps.
        if used[number] or scale <= 0.0 or 3 * box[3] * scale < _POST.min_height_m:
            continue
        above = number + np.flatnonzero(_stand_above(boxes[number:], box, _POST.gap_m / scale))
        used[above] = True
        whole = _around(boxes[np.append(above, number)])
        edges = _edges(level, whole)
        if edges is None or whole[3] < 4:
            continue
        height_m, width_m = whole[3] * scale, (edges[1] - edges[0]) * scale
        is_high = _POST.min_height_m <= height_m <= _POST.max_height_m
        is_slim = _POST.min_width_m <= width_m <= _POST.max_width_m
        if is_high and is_slim and _is_white(image, whole) and _stands_out(level, whole):
            out[whole[1] : whole[1] + whole[3], (columns > edges[0]) & (columns < edges[1])] = True


def _boxes(bars: np.ndarray) -> np.ndarray:
    """Left column, top row, width and height of each bar, int[bars 4]."""
    at = np.flatnonzero(bars > 0)
    v, u = np.divmod(at, bars.shape[1])
    number = cv2.connectedComponents(bars, connectivity=8)[1].ravel()[at] - 1
    (left, right), (top, bottom) = (extremes(side, number) for side in (u, v))
    return np.stack([left, top, right + 1 - left, bottom + 1 - top], axis=-1)


def _stand_above(boxes: np.ndarray, box: np.ndarray, gap_px: float) -> np.ndarray:
    """Which boxes (u, v, width, height) begin above another by no more than a gap, in the same columns."""
    gap = box[1] - (boxes[:, 1] + boxes[:, 3])
    beside = np.abs(boxes[:, 0] + 0.5 * boxes[:, 2] - box[0] - 0.5 * box[2])
    return (gap >= 0) & (gap <= gap_px) & (beside <= 1.5)


def _around(boxes: np.ndarray) -> tuple[int, int, int, int]:
    """The box around boxes."""
    low, high = boxes[:, :2].min(axis=0), (boxes[:, :2] + boxes[:, 2:]).max(axis=0)
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _edges(level: np.ndarray, box: tuple[int, int, int, int]) -> tuple[float, float] | None:
    """Columns of the left and right border from the mean profile over the rows of a bar; None where one is missing."""
    u, v, width, height = box
    margin = width + 4
    first, last = max(u - margin, 0), min(u + width + margin, level.shape[1])
    profile = np.median(np.exp(level[v : v + height, first:last]), axis=0)
    peak = int(np.argmax(profile[u - first : u - first + width])) + u - first
    borders = []
    for side in (profile[peak::-1], profile[peak:]):
        half = 0.5 * (side[0] + side[: width + 4].min())
        below = np.flatnonzero(side < half)
        if not len(below):
            return None
        at = int(below[0])
        borders.append(at - 1 + float((side[at - 1] - half) / max(side[at - 1] - side[at], 1e-6)))
    return first + peak - borders[0], first + peak + borders[1]


def _sides(values: np.ndarray, box: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values in the rows of a bar: in its own columns, to its left and right, float32[rows columns ...] each."""
    u, v, width, height = box
    reach = width + 2
    rows = values[v : v + height].astype(np.float32, copy=False)
    padded = np.pad(rows, [(0, 0), (reach, reach)] + [(0, 0)] * (values.ndim - 2), "edge")
    left, own, right = padded[:, u : u + reach - 1], padded[:, u + reach :], padded[:, u + reach + width + 1 :]
    return own[:, :width], left, right[:, : reach - 1]


def _stands_out(level: np.ndarray, box: tuple[int, int, int, int]) -> bool:
    """Whether a bar is brighter than both its sides by more than what is around it varies: leaves are full of bars."""
    own, left, right = _sides(level, box)
    contrast = np.median(own.max(axis=1) - np.maximum(left.mean(axis=1), right.mean(axis=1)))
    u, v, width, height = box
    around = level[max(v - height // 2, 0) : v + height + height // 2, max(u - 3 * height, 0) : u + width + 3 * height]
    texture = np.sqrt(np.mean(np.diff(around, axis=1) ** 2))
    return bool(contrast >= _POST.min_texture * texture)


def _is_white(image: np.ndarray, box: tuple[int, int, int, int]) -> bool:
    """Whether a bar has as much more blue than its sides as it has more green and red.

    A pixel that the bar fills in part has the same shares, so bars far away do, too. Leaves in the sun before leaves
    in the shade have little more blue.
    """
    own, left, right = _sides(image, box)
    body = own.min(axis=(1, 2))
    lit = body >= np.median(body)
    blue, green, red = own[lit].mean(axis=(0, 1)) - 0.5 * (left[lit] + right[lit]).mean(axis=(0, 1))
    return bool(blue >= _POST.min_blue * max(green, red, 1.0))
