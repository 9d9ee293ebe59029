"""Paint across and along a stroke: its middle, its width, its end (room: mapping; host).

In: share of looks that show paint, by cell, a place and a direction. Out: StrokeProfile; where the paint ends.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

STEP = 4
"""Cells from one place of a stroke to the next: 10 cm at 2.5 cm."""
_NUM_ALONG = 5
"""Cells along a stroke over which a profile is averaged."""
_ACROSS = 0.5
"""Cells from one value of a profile to the next."""
_PEAK_PART = 0.8
"""Part of the least share that a profile must reach where most looks show the paint."""
_BACK_FROM_END = 24.0
"""Cells before the last place of a stroke whose paint says where its end is."""


@dataclass(frozen=True)
class TraceLimits:
    """What counts as a stroke, in cells.

    Args:
        widest: a wider profile is a junction with other paint; its middle does not count.
        reach: how far to either side of the middle paint is looked at.
        bridged: longest gap that is passed over.
        smallest: area below which paint is noise.
        least_share: of the looks that show paint; narrow paint far away is smeared over more cells than it covers.
        faint_share: what a stroke that was begun is followed through: masks that miss paint in most looks show bare
            road as paint in far fewer.
        along: a stroke ends where it runs along another for longer than this; what it crosses or meets is shorter.
    """

    widest: float = 14.0
    reach: float = 12.0
    bridged: float = 16.0
    smallest: float = 40.0
    least_share: float = 0.5
    faint_share: float = 0.2
    along: float = 24.0

    @property
    def strong_share(self) -> float:
        """What the largest share of a profile reaches where most looks show the paint."""
        return _PEAK_PART * self.least_share


class StrokeProfile(NamedTuple):
    """Paint across a place.

    Attributes:
        offset: how far its middle is off the place, in cells.
        amount: of cells of full paint, the shares of all cells together.
        peak: the largest share.
    """

    offset: float
    amount: float
    peak: float

    @property
    def width(self) -> float:
        """Width where most looks show the paint, in cells."""
        return self.amount / max(self.peak, 0.8)

    def is_of(self, width: float, limits: TraceLimits) -> bool:
        """Whether it can be paint of a stroke of this width: a mask that is off in one look leaves a thin streak."""
        return self.peak >= limits.strong_share or self.amount >= limits.faint_share * width


def profile_across(
    share: np.ndarray, place: np.ndarray, direction: np.ndarray, limits: TraceLimits
) -> StrokeProfile | None:
    """The paint across a place; None where there is none near the middle, not even faint."""
    across = paint_across(share, place, direction, limits.reach)
    middle, around = len(across) // 2, int(0.34 * limits.reach / _ACROSS)
    near = across[middle - around : middle + around + 1]
    centre = middle - around + int(near.argmax())
    peak = float(across[centre])
    if peak < limits.faint_share:
        return None
    paint = across > 0.5 * peak
    to_left, to_right = _length(paint[centre::-1]), _length(paint[centre:])
    # The soft rims belong to the paint: half of it would be cut off at the threshold.
    low, high = max(centre + 1 - to_left - 3, 0), min(centre + to_right + 3, len(paint))
    weight = across[low:high]
    total = float(weight.sum())
    offset = float(weight @ np.arange(low - middle, high - middle)) * _ACROSS / total
    return StrokeProfile(offset, _ACROSS * total, peak)


def paint_across(share: np.ndarray, place: np.ndarray, direction: np.ndarray, reach: float) -> np.ndarray:
    """Paint across a place, from `reach` to the right to `reach` to the left of the direction, averaged along it."""
    num = 2 * round(reach / _ACROSS) + 1
    aside = _ACROSS * normal(direction)
    first = place - 0.5 * (num - 1) * aside - 0.5 * (_NUM_ALONG - 1) * direction
    turn = np.array([[aside[0], direction[0], first[0]], [aside[1], direction[1], first[1]]])
    seen = cv2.warpAffine(share, turn, (num, _NUM_ALONG), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return cv2.reduce(seen, 0, cv2.REDUCE_AVG)[0]


def _length(paint: np.ndarray) -> int:
    """How many values from the first on are paint."""
    first = int(paint.argmin())
    return first if not paint[first] else len(paint)


def normal(direction: np.ndarray) -> np.ndarray:
    return np.array([-direction[1], direction[0]])


def end_of_paint(
    share: np.ndarray, looked: np.ndarray, last: np.ndarray, direction: np.ndarray, limits: TraceLimits
) -> tuple[np.ndarray, bool]:
    """Where paint falls below half, past the last place, and whether the road behind was looked at."""
    s = np.arange(-_BACK_FROM_END, limits.bridged + 0.25, 0.5)
    offsets = np.array([-1.5, -0.5, 0.5, 1.5])
    at = last + s[:, None, None] * direction + offsets[None, :, None] * normal(direction)
    along = share_at(share, at).mean(axis=1)
    # Masks that miss the last piece of paint leave it faint: it ends where it falls to half of what it is there.
    half = 0.5 * max(float(np.quantile(along[s <= 0.0], 0.75)), 2.0 * limits.faint_share)
    k = int(np.flatnonzero(along >= half)[-1]) + 1 if (along >= half).any() else len(s)
    if k >= len(s):
        return last, False
    step = along[k - 1] - along[k]
    part = np.clip((along[k - 1] - half) / step, 0.0, 1.0) if step > 1e-6 else 0.0
    end = s[k - 1] + 0.5 * part
    behind = last + (end + 8.0) * direction
    seen = share_at(looked.astype(np.float32), behind[None, None])[0, 0] > 0.5
    return last + end * direction, bool(seen)


def share_at(share: np.ndarray, xy: np.ndarray) -> np.ndarray:
    flat = xy.reshape(-1, 2)
    return map_coordinates(share, [flat[:, 1], flat[:, 0]], order=1, mode="constant").reshape(xy.shape[:-1])
