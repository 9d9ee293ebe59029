"""Dashes that are shorter than a stroke can be followed: rows of spots of paint (room: mapping; host).

In: share of looks that show paint, by cell. Out: a PaintTrace for each spot of a row.
One spot may be dirt or a piece of something; studs and short dashes stand in rows, alike and on one line.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from semloc_jax.mapping.strokes import PaintTrace

SPOT_OFF_M = 0.1
"""Looks at a spot from afar are off by as much as it is large."""
_NUM_ROW = 4
"""Spots of a row; chance makes three."""
_ALIKE = 2.0
"""Ratio of the areas of two spots of one row: how much is seen of each differs."""
_OFF_ROW = 8.0
"""Cells by which a spot may be off its row."""
_COMPACT = 0.55
"""A spot that fills less of its rectangle is none."""
_RIM, _BARE = 3, 8
"""Cells around a spot that its blur reaches; beyond them the road is bare, else it is a piece of something."""
_BARE_SHARE = 0.1
_PLACES = 5


class SpotLimits(NamedTuple):
    """What counts as a spot, in cells.

    Args:
        least_share: of the looks that show it.
        shortest: side of its square, as large as it is.
        longest: a longer one is followed as a stroke.
        widest: a wider one is no dash.
        apart: farthest from one of a row to the next.
    """

    least_share: float
    shortest: float
    longest: float
    widest: float
    apart: float


def rows_of_spots(
    share: Float[np.ndarray, "h w"],
    looked: Bool[np.ndarray, "h w"],
    strokes: list[PaintTrace],
    limits: SpotLimits,
) -> list[PaintTrace]:
    """Every spot that stands in a row of such spots, as a dash along the row.

    Args:
        share: paint by cell, 0 to 1.
        looked: cells that were seen often enough.
        strokes: what else there is: no spot is a part of it.
        limits: what counts as a spot.
    """
    paint = ((share > limits.least_share) & looked).astype(np.uint8)
    for stroke in strokes:
        line = np.rint(stroke.middle * 8).astype(np.int32)[None]
        cv2.polylines(paint, line, False, 0, max(int(stroke.width + 5), 3), cv2.LINE_8, 3)
    num, labels, boxes, _ = cv2.connectedComponentsWithStats(paint, connectivity=8)
    spots = []
    for index in range(1, num):
        x, y, width, height, area = (int(v) for v in boxes[index])
        is_small = limits.shortest**2 <= area <= limits.longest * limits.widest
        if is_small and max(width, height) <= 1.5 * limits.longest and _is_alone(share, labels, index, boxes[index]):
            box = slice(y, y + height), slice(x, x + width)
            spots.append(_cells(labels[box] == index, share[box], x, y))
    if len(spots) < _NUM_ROW:
        return []
    middles = np.array([np.average(xy, axis=0, weights=weight) for xy, weight in spots])
    areas = np.array([len(xy) for xy, _ in spots])
    along = _along_rows(middles, areas, limits.apart)
    found = []
    for (xy, _), middle, axis in zip(spots, middles, along, strict=True):
        dash = None if not axis.any() else _dash(xy, middle, axis, limits)
        if dash is not None:
            found.append(dash)
    return found


def _cells(own: np.ndarray, share: np.ndarray, x: int, y: int) -> tuple[np.ndarray, np.ndarray]:
    """Places of the cells of a spot and how much paint they show."""
    rows, columns = np.nonzero(own)
    return np.stack([columns + x, rows + y], axis=1).astype(np.float64), share[rows, columns]


def _is_alone(share: np.ndarray, labels: np.ndarray, index: int, box: np.ndarray) -> bool:
    """Whether the road around a spot is bare."""
    x, y, width, height = (int(v) for v in box[:4])
    top, left = max(y - _BARE, 0), max(x - _BARE, 0)
    window = slice(top, y + height + _BARE), slice(left, x + width + _BARE)
    own = (labels[window] == index).astype(np.uint8)
    inner, outer = (cv2.dilate(own, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) for reach in (_RIM, _BARE))
    peak = float(share[window][own > 0].max())
    return float((share[window][outer > inner] > 0.5 * peak).mean()) < _BARE_SHARE


def _along_rows(
    middles: Float[np.ndarray, "n 2"], areas: Int[np.ndarray, " n"], apart: float
) -> Float[np.ndarray, "n 2"]:
    """Direction of the row that each spot stands in; zero where it stands in none."""
    along = np.zeros((len(middles), 2))
    near = cKDTree(middles).query_ball_point(middles, _NUM_ROW * apart)
    for k, others in enumerate(near):
        ratio = np.maximum(areas[others] / areas[k], areas[k] / areas[others])
        off = middles[[j for j, r in zip(others, ratio, strict=True) if j != k and r <= _ALIKE]] - middles[k]
        ways = off / np.linalg.norm(off, axis=1, keepdims=True)
        # Along the way to each of the others: who else is on that line.
        across = np.abs(off[:, 0] * ways[:, 1:] - off[:, 1] * ways[:, :1])
        best = 0
        for way, is_on in zip(ways, across <= _OFF_ROW, strict=True):
            count = _connected(off[is_on] @ way, apart)
            if count > best:
                best, along[k] = count, way
        if best + 1 < _NUM_ROW:
            along[k] = 0.0
    return along


def _connected(at: Float[np.ndarray, " m"], apart: float) -> int:
    """How many of some places along a row hang together with 0, from one to the next."""
    at = np.sort(np.append(at, 0.0))
    broken = np.append(0, np.cumsum(np.diff(at) > apart))
    return int((broken == broken[np.searchsorted(at, 0.0)]).sum()) - 1


def _dash(xy: np.ndarray, middle: np.ndarray, axis: np.ndarray, limits: SpotLimits) -> PaintTrace | None:
    """A spot as a dash along a direction: as long and wide as a rectangle with its second moments."""
    length, width = (_extent((xy - middle) @ way) for way in (axis, np.array([-axis[1], axis[0]])))
    if len(xy) < _COMPACT * length * width or length > limits.longest or width > limits.widest:
        return None
    s = np.linspace(-0.5 * length, 0.5 * length, _PLACES)
    return PaintTrace(middle + s[:, None] * axis, width, (True, True))


def _extent(off: np.ndarray) -> float:
    """Side of a rectangle whose cells are so far from its middle along it."""
    return float(np.sqrt(12.0 * np.mean(off**2) + 1.0))
