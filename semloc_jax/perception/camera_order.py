"""Do pictures and calibration of a surround view belong together? (room: perception; host).

In: a SurroundView and pictures. Out: a verdict: the order of the cameras, or the calibration, that looks wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np

from semloc_jax.perception.surround import SurroundView
from semloc_jax.perception.surround_quality import correlation, neighbours, overlap_matches

_LEAST_FOUND, _LIKELY_FOUND, _LEAST_ALIKE, _FEWEST_TRIED = 0.15, 0.25, 0.1, 15
"""Share of the spots of one camera that its neighbour must, and should, show too, and correlation of the two in their
overlap, once there are enough spots to say so. Measured: 0.4 to 0.9 and 0.2 to 0.6 with the right pictures, 0.22 and
0.06 with mounts 30 cm off, below 0.15 and 0.1 with pictures of other roads."""
_CLEARLY, _PLAINLY = 0.1, 0.25
"""By how much the overlaps of another order must be more alike where spots are missed, and in any case."""
_CLEARLY_FOUND = 2.0, 0.05
"""In a better order so many times the share of spots is found again, and so much more."""
_FAR_APART_M = 0.12


@dataclass(frozen=True)
class Belonging:
    """Whether pictures fit a calibration.

    Attributes:
        likeness: mean correlation of neighbouring cameras in their overlaps.
        found: share of the spots of one camera that its neighbour shows too; nan where nothing could be tried.
        num_tried: how many there were.
        apart_m: median distance between the two; nan where none was found.
        better_order: the order of the pictures that would fit clearly better, as indices; None where there is none.
    """

    likeness: float
    found: float
    num_tried: int
    apart_m: float
    better_order: tuple[int, ...] | None

    @property
    def contradicts(self) -> bool:
        """Whether neighbours do not show the same road."""
        return self.num_tried >= _FEWEST_TRIED and self.found < _LEAST_FOUND and self.likeness < _LEAST_ALIKE

    @property
    def is_far_apart(self) -> bool:
        """Whether neighbours show the same road at clearly different places, or hardly show the same road."""
        return self.num_tried >= _FEWEST_TRIED and (self.found < _LIKELY_FOUND or self.apart_m > _FAR_APART_M)


def belonging(view: SurroundView, frames: Sequence[Sequence[np.ndarray]]) -> Belonging:
    """Whether neighbouring cameras show the same road, over a few frames.

    Args:
        view: the top view.
        frames: uint8[h w 3] of every camera, for each frame.
    """
    bands = neighbours(view)
    found, num_tried, apart_m = _found_again(view, frames, bands)
    likeness = np.mean([_likeness(view, images, bands) for images in frames], axis=0)
    orders = [order for order in permutations(range(len(view.image_uv))) if _same_sizes(view, order)]
    pairs = [(i, j) for i, j, _ in bands]
    score = {order: _mean([likeness[k, order[i], order[j]] for k, (i, j) in enumerate(pairs)]) for order in orders}
    own = tuple(range(len(view.image_uv)))
    best = max(score, key=lambda order: score[order])
    margin = _CLEARLY if num_tried >= _FEWEST_TRIED and found < _LIKELY_FOUND else _PLAINLY
    is_better = score[best] > max(score[own] + margin, 1.5 * _LEAST_ALIKE)
    if is_better:
        # With the calibration of another car some order is always more alike; its spots are found no better.
        there, _, _ = _found_again(view, [[images[k] for k in best] for images in frames], bands)
        is_better = there > _CLEARLY_FOUND[0] * np.nan_to_num(found) + _CLEARLY_FOUND[1]
    return Belonging(score[own], found, num_tried, apart_m, best if is_better else None)


def _found_again(view: SurroundView, frames: Sequence[Sequence[np.ndarray]], bands: list) -> tuple[float, int, float]:
    """Share of the spots that the neighbour shows too (nan where none was tried), how many, median distance [m]."""
    matches = [overlap_matches(view, images, bands) for images in frames]
    num_tried, apart = sum(m.num_tried for m in matches), np.concatenate([m.apart_m for m in matches])
    found = len(apart) / num_tried if num_tried else float("nan")
    return found, num_tried, float(np.median(apart)) if len(apart) else float("nan")


def named_order(names: Sequence[str], order: Sequence[int]) -> str:
    """Which camera shows what belongs to which, for people; `order` as in `Belonging.better_order`."""
    moved = [k for k, other in enumerate(order) if k != other]
    return ", ".join(f"{names[k]} shows what belongs to {names[list(order).index(k)]}" for k in moved)


def _likeness(view: SurroundView, images: Sequence[np.ndarray], bands: list) -> np.ndarray:
    """Correlation of any two pictures laid out as those of each pair of neighbours, float64[pairs n n]."""
    num = len(images)
    found = np.zeros((len(bands), num, num))
    grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in images]
    for k, (i, j, band) in enumerate(bands):
        as_i, as_j = ([cv2.remap(g, view.image_uv[c], None, cv2.INTER_LINEAR) for g in grey] for c in (i, j))
        for a in range(num):
            for b in range(num):
                if a != b:
                    found[k, a, b] = correlation(as_i[a], as_j[b], band, view.metres_per_px)
    return found


def _same_sizes(view: SurroundView, order: tuple[int, ...]) -> bool:
    return all(view.resolutions[k] == view.resolutions[other] for k, other in enumerate(order))


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else 0.0
