"""What the way of a vehicle says of its focal lengths, where single frames say little (room: localization; host).

In: frames solved with other focal lengths, how measured poses differ from predicted ones. Out: LensWay; what it says.
A focal length that is stated too long puts the vehicle behind by a share of how far ahead the contours are that hold
its pose. As these come nearer and leave the view, the pose moves against the wheels by the same share of their change.
What pixels do to masks makes every frame like a lens that is some percent longer or shorter, and does not do that.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.localization.other_calibrations import STEPS

_MEMORY_LOOKS = 200.0
"""No lens changes while driving, but what hides it may. Ours."""
_LEAST_LOOKS = 8.0
"""Fewer tell no scatter. Ours."""
_MOST_NOISE = 0.5
"""Share of what solves with other lenses differ from look to look that may be scatter of the solves. Ours."""
_OF_SIZE = 0.2
"""Far lenses are told a fifth too small or more: solves with another lens are as rugged, and follow it less. On exact
masks of two country roads and of a real drive -1.6, -1.6 and -1.3 steps were told where -2 is true."""


class LensWay(NamedTuple):
    """Sums over looks, by the information of what masks and motion differ along the way."""

    num: Float[np.ndarray, ""] = np.float64(0.0)
    ahead_m: Float[np.ndarray, ""] = np.float64(0.0)
    """How far ahead a lens that is a step longer puts the fused pose: that of the last looks, as the fusion has it."""
    squares: Float[np.ndarray, ""] = np.float64(0.0)
    """Of what a look has more than that."""
    noise: Float[np.ndarray, ""] = np.float64(0.0)
    """Part of these squares that is scatter of the solves."""
    products: Float[np.ndarray, ""] = np.float64(0.0)
    """With how far ahead of the predicted pose the measured one is."""
    differences: Float[np.ndarray, ""] = np.float64(0.0)
    """Squares of the latter."""


def learned(way: LensWay, ahead_m: Float[np.ndarray, "4"], difference_m: float, sigma_m: float, gain: float) -> LensWay:
    """The sums after one more look; where not every step was asked it says nothing.

    Args:
        way: Before.
        ahead_m: How far ahead the pose moves with focal lengths that are longer by each of `STEPS`.
        difference_m: How far ahead of the predicted pose the measured one is.
        sigma_m: Standard deviation of that difference.
        gain: Share of the difference that the fused pose followed.
    """
    if not np.isfinite([*ahead_m, difference_m, sigma_m]).all():
        return way
    # A line through the pose with its own lens and those with others: its slope is less rugged than any of them.
    columns = np.stack([np.ones(len(STEPS) + 1), [0.0, *STEPS]], axis=1)
    (offset_m, slope_m), square, _, _ = np.linalg.lstsq(columns, np.array([0.0, *ahead_m]), rcond=None)
    noise_m2 = float(square[0]) / (len(columns) - 2) / float(np.sum(STEPS**2))
    # The first looks are their own mean.
    share = max(min(gain, 1.0), 1.0 / (float(way.num) + 1.0))
    more_m, worth = slope_m - float(way.ahead_m), 1.0 / sigma_m**2
    ahead = np.float64(way.ahead_m + share * more_m)
    if way.num == 0.0:
        return way._replace(num=np.float64(1.0), ahead_m=ahead)
    new = more_m**2, noise_m2, more_m * (difference_m + offset_m), (difference_m + offset_m) ** 2
    keep = np.exp(-1.0 / _MEMORY_LOOKS)
    sums = (keep * old + worth * one for old, one in zip(way[2:], new, strict=True))
    return LensWay(np.float64(keep * way.num + 1.0), ahead, *(np.float64(one) for one in sums))


def told(way: LensWay) -> tuple[float, float] | None:
    """By how many steps the focal lengths are longer than stated, and the variance of that; None where the way does
    not tell."""
    squares = float(way.squares - way.noise)
    if way.num < _LEAST_LOOKS or squares < (1.0 - _MOST_NOISE) * float(way.squares):
        return None
    at = -float(way.products) / squares
    # What masks and motion differ may be more than is stated, not less.
    scatter = max(float(way.differences) / float(way.num), 1.0)
    return at, scatter * float(way.squares) / squares**2 + (_OF_SIZE * at) ** 2
