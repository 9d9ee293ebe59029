"""An error of wheels or clocks that masks have neither told nor excluded, weighed by Bayes (room: localization; host).

In: Causes, Innovations. Out: Causes with one more.
Wheels that stick and times of frames that jump make the masks of each frame differ from the motion since the one
before. Where masks of single frames hold little along the road, such differences pass for their noise, which is
learned from them: they hardly move the pose, which is then off by as much.
"""

import numpy as np
from jaxtyping import Float
from scipy.special import expit, logit

from semloc_jax.evaluation.mixture_bounds import Causes
from semloc_jax.localization.innovations import Innovations, along
from semloc_jax.localization.weighed_faults import PROBABILITY

_LEAST_FRAMES = 2.0
"""One frame is an outlier."""


def with_motion(
    causes: Causes, fits: Innovations, own_sigma: Float[np.ndarray, "3"], freedom: Float[np.ndarray, "3"]
) -> Causes:
    """The causes with that of a motion which is as far off along the way as masks differ from it.

    Where it is, this frame's masks say where the pose is, as well as they are believed.

    Args:
        causes: From `weighed_faults.weighed`.
        fits: How measured poses fitted the motion between them of late.
        own_sigma: Standard deviations of the pose without faults: left [m], ahead [m], heading [deg].
        freedom: Degrees of freedom that these stand on.
    """
    num, away_m2, ratio = along(fits)
    if num < _LEAST_FRAMES:
        return causes
    # By how much likelier what these frames differ is where the motion adds as much again as they all do.
    nats = 0.5 * num * (ratio**2 / (1.0 + ratio) - np.log1p(ratio))
    difference_m, masks_m2 = fits.last
    by_motion = away_m2 / (away_m2 + masks_m2)
    mean, sigma, free = np.zeros(3), own_sigma.copy(), freedom.copy()
    # Few frames tell how large the differences are.
    mean[1], sigma[1], free[1] = by_motion * difference_m, np.sqrt(by_motion * masks_m2), min(num, freedom[1])
    sigma[1] = np.hypot(sigma[1], own_sigma[1])
    row = np.array([expit(logit(PROBABILITY) + nats)]), mean[None], sigma[None], free[None]
    return Causes(*(np.concatenate(parts) for parts in zip(causes, row, strict=True)))
