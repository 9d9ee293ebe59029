"""Strokes of paint followed along their middle through a picture of the road from above (room: mapping; host).

In: share of looks that show paint, by cell. Out: PaintTrace: middle, width and ends, to a fraction of a cell.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.mapping.stroke_profiles import STEP, TraceLimits, end_of_paint, normal, profile_across, share_at

_CLEAR = 6.0
"""Ratio of the moments of paint from which its direction is clear."""
_BACK = 14
"""Places whose straight line gives the direction of the next step."""


@dataclass(frozen=True)
class PaintTrace:
    """One stroke, in cells of the picture.

    Attributes:
        middle: `float64[k 2]` x, y along the stroke; the ends are those of the paint.
        width: typical width.
        is_end: whether paint ends at the first and at the last point where the road goes on bare, and was seen.
    """

    middle: Float[np.ndarray, "k 2"]
    width: float
    is_end: tuple[bool, bool]

    @property
    def length(self) -> float:
        """Length from end to end."""
        return float(np.linalg.norm(np.diff(self.middle, axis=0), axis=1).sum())


def find_strokes(
    share: Float[np.ndarray, "h w"], looked: Bool[np.ndarray, "h w"], limits: TraceLimits | None = None
) -> list[PaintTrace]:
    """Follow every stroke in a picture.

    Args:
        share: paint by cell, 0 to 1.
        looked: cells that were seen often enough.
        limits: what counts as a stroke.
    """
    limits = limits or TraceLimits()
    free = ((share > limits.least_share) & looked).astype(np.uint8)
    num, labels, stats, _ = cv2.connectedComponentsWithStats(free, connectivity=8)
    found, covered = [], np.zeros(free.shape, np.uint8)
    for index in range(1, num):
        x, y, width, height, area = (int(v) for v in stats[index])
        if area >= limits.smallest:
            box = slice(y, y + height), slice(x, x + width)
            # Paint already taken by a stroke that bridged a gap is not followed again.
            own = (labels[box] == index) & (free[box] > 0)
            found += _strokes_of(share, looked, own, box, free, covered, limits)
    return found


def _strokes_of(
    share: np.ndarray,
    looked: np.ndarray,
    own: np.ndarray,
    box: tuple[slice, slice],
    free: np.ndarray,
    covered: np.ndarray,
    limits: TraceLimits,
) -> list[PaintTrace]:
    """The strokes that begin in one patch of connected paint; they are followed out of it.

    Args:
        share: paint by cell of the whole picture.
        looked: cells that were seen often enough.
        own: cells of the patch.
        box: where these lie in the picture.
        free: paint that no stroke has; what is looked at here is taken out of it.
        covered: cells on the strokes of the picture; those found here are added.
        limits: what counts as a stroke.
    """
    found, origin = [], np.array([box[1].start, box[0].start], float)
    for _ in range(200):
        if own.sum() < limits.smallest:
            break
        # Cells around a patch are not of it, also where it fills its box.
        depth = cv2.distanceTransform(np.pad(own.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
        seed = np.array(np.unravel_index(int(depth.argmax()), depth.shape), dtype=float)[::-1]
        stroke = _followed(share, looked, own, seed, origin, limits)
        stroke = None if stroke is None else _own_part(stroke, seed + origin, covered, limits.along)
        if stroke is None:
            cv2.circle(free, tuple(np.rint(seed + origin).astype(int).tolist()), int(limits.reach), 0, -1)
        else:
            line = np.rint(stroke.middle * 8).astype(np.int32)[None]
            wide = max(int(stroke.width + 5), 3)
            cv2.polylines(free, line, False, 0, wide, cv2.LINE_8, 3)
            cv2.polylines(covered, line, False, 1, wide, cv2.LINE_8, 3)
            found.append(stroke)
        own = _without_crumbs(own & (free[box] > 0), limits.smallest)
    return found


def _own_part(stroke: PaintTrace, seed: np.ndarray, covered: np.ndarray, along: float) -> PaintTrace | None:
    """What of a stroke goes on from its seed to where it runs along another one; None where the seed leads to one.

    The rims of a stroke lead back to its middle, and where two lines come together the paint of both is one. A line
    that crosses or meets another shares but its width with it, and keeps its end there.
    """
    middle, (height, width) = stroke.middle, covered.shape
    x, y = np.rint(middle).astype(int).T
    is_shared = covered[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)] > 0
    start = int(np.linalg.norm(middle - seed, axis=1).argmin())
    if is_shared[start]:
        return None
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1)))
    low, high = 0, len(middle)
    for first, end in np.flatnonzero(np.diff(np.pad(is_shared, 1).astype(int))).reshape(-1, 2):
        if s[end - 1] - s[first] <= along:
            continue
        if end <= start:
            low = int(end)
        else:
            high = min(high, int(first))
    ends = stroke.is_end[0] and low == 0, stroke.is_end[1] and high == len(middle)
    return PaintTrace(middle[low:high], stroke.width, ends) if high - low >= 2 else None


def _without_crumbs(own: np.ndarray, smallest: float) -> np.ndarray:
    """Without the parts that are smaller than paint is: the rims that a stroke leaves."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(own.astype(np.uint8), connectivity=8)
    is_kept = stats[:, cv2.CC_STAT_AREA] >= smallest
    is_kept[0] = False
    return is_kept[labels]


def _followed(
    share: np.ndarray,
    looked: np.ndarray,
    own: np.ndarray,
    seed: np.ndarray,
    origin: np.ndarray,
    limits: TraceLimits,
) -> PaintTrace | None:
    """The stroke through a place of a patch, which begins at `origin` in the picture."""
    place = seed + origin
    direction = _direction(share, own, seed, origin, limits)
    if direction is None:
        return None
    first = profile_across(share, place, direction, limits)
    if first is None or first.peak < limits.strong_share:
        return None
    middle = place + first.offset * normal(direction)
    ways = [_one_way(share, looked, middle, sign * direction, first.width, limits) for sign in (1.0, -1.0)]
    middle = np.vstack([ways[1][0][::-1], ways[0][0][1:]])
    middle = middle[np.append(True, np.linalg.norm(np.diff(middle, axis=0), axis=1) > 1e-3)]
    widths = np.concatenate([ways[0][1], ways[1][1][1:]])
    if len(middle) < 2:
        return None
    return PaintTrace(middle, float(np.median(widths)), (ways[1][2], ways[0][2]))


def _direction(
    share: np.ndarray, own: np.ndarray, seed: np.ndarray, origin: np.ndarray, limits: TraceLimits
) -> np.ndarray | None:
    """Main direction of the paint around a place; where lines meet, that in which paint goes on longest."""
    r = 30
    x, y = np.rint(seed).astype(int)
    rows, columns = np.nonzero(own[max(y - r, 0) : y + r, max(x - r, 0) : x + r])
    if len(rows) < 8:
        return None
    near = np.stack([columns, rows], axis=1) - np.mean([columns, rows], axis=1)
    values, vectors = np.linalg.eigh(near.T @ near)
    if values[1] > _CLEAR * values[0]:
        return vectors[:, 1]
    angles = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    reach = np.arange(2.0, 80.0, 2.0)
    paint = share_at(share, seed + origin + reach[None, :, None] * ways[:, None]) > limits.strong_share
    length = np.where(paint.all(axis=1), len(reach), paint.argmin(axis=1))
    return ways[int(length.argmax())] if length.max() >= 4 else None


def _one_way(
    share: np.ndarray,
    looked: np.ndarray,
    start: np.ndarray,
    direction: np.ndarray,
    width_there: float,
    limits: TraceLimits,
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Places from a start to the end of the paint, widths there, and whether bare road was seen behind the end."""
    places, widths = [start], [width_there]
    at, gap = start, 0.0
    height, width = share.shape
    while True:
        at = at + STEP * direction
        if not (2 < at[0] < width - 3 and 2 < at[1] < height - 3):
            break
        found = profile_across(share, at, direction, limits)
        if found is None or not found.is_of(widths[-1], limits):
            gap += STEP
            if gap > limits.bridged:
                break
            continue
        gap = 0.0
        if found.width <= limits.widest:
            at = at + float(np.clip(found.offset, -1.5, 1.5)) * normal(direction)
            places.append(at)
            if found.peak >= limits.strong_share:
                widths.append(found.width)
        recent = np.array(places[-_BACK:])
        if len(recent) >= 4:
            direction = _straight(recent, direction)
    end, is_end = end_of_paint(share, looked, places[-1], direction, limits)
    return np.vstack([*places, end]), np.array(widths), is_end


def _straight(places: np.ndarray, direction: np.ndarray) -> np.ndarray:
    near = places - places.mean(axis=0)
    (xx, xy), (_, yy) = (near.T @ near).tolist()
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    found = np.array([math.cos(angle), math.sin(angle)])
    return found if found @ direction > 0 else -found
