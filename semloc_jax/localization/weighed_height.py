"""A horizontal focal length that hides in the height of the vehicle, weighed by Bayes (room: localization; host).

In: Causes, WatchState. Out: Causes with one more.
A horizontal focal length that is 5 % too long makes the road 5 % wider than it is: lines then fit from 5 % higher, and
from there all that lies ahead is seen 5 % farther away. Small masks do not tell that by their fit. The mounts say how
high the cameras stand, and it is as probable that they are wrong as that the lens is.
"""

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.frame_levels import AS_LEVELS
from semloc_jax.cameras.other_lenses import FOCAL_SHARE
from semloc_jax.evaluation.mixture_bounds import Causes
from semloc_jax.localization.other_calibrations import FOCAL, alternatives
from semloc_jax.localization.watch_sums import WatchState, means_of
from semloc_jax.localization.weighed_faults import PROBABILITY, SizeTold, as_causes, off_by_far

_OWN_M = 0.015
"""How much higher or lower a vehicle stands by its load, one standard deviation. Ours. What the map leaves open of its
surface is another in every stretch of road."""


def with_height(
    causes: Causes,
    watch: WatchState,
    camera_m: float,
    own_sigma: Float[np.ndarray, "3"],
    freedom: Float[np.ndarray, "3"],
) -> Causes:
    """The causes with that of a horizontal focal length for which the vehicle stands as high as it was found.

    Args:
        causes: From `weighed_faults.weighed`.
        watch: Sums over the last frames.
        camera_m: How high the cameras stand over the road by their mounts [m].
        own_sigma: Standard deviations of the pose without faults: left [m], ahead [m], heading [deg].
        freedom: Degrees of freedom that these stand on.
    """
    row, num = alternatives(1).index(FOCAL), float(watch.stance.num)
    if num <= 0.0 or not len(watch.num) or camera_m <= 0.0:
        return causes
    asked, _, moves = means_of(watch, row)
    if (asked[:2] < 0.5).any():
        return causes
    step_m = FOCAL_SHARE * camera_m
    height_m = float(watch.stance.total[0]) / num
    variance_m2 = float(watch.stance.left_open[0]) / num / max(num, 1.0) + _OWN_M**2
    # A lens that is stated too long puts the vehicle higher; the right one is shorter.
    told = SizeTold(-height_m / step_m, variance_m2 / step_m**2, (0.5 * (moves[0] - moves[1]))[AS_LEVELS])
    probability, mean, sigma = off_by_far(told, PROBABILITY)
    mounts_too = probability / (1.0 + probability)
    found = as_causes((mounts_too, mean, sigma), own_sigma, freedom)
    return Causes(*(np.concatenate(parts) for parts in zip(causes, found, strict=True)))
