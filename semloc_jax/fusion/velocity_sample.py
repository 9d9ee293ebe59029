"""A measured velocity of the vehicle, with what is new and what lasts of its error (room: fusion; host).

In: numbers of wheels or of `seen_velocity`. Out: VelocitySample, which a MotionLog hands to a fusion.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class VelocitySample(NamedTuple):
    """Velocity of the base in its own axes by wheels or cameras, which share one error of scale."""

    velocity_base: Float[np.ndarray, "3"]
    """[m/s]."""
    sigma: Float[np.ndarray, "3"]
    """Its standard deviation beside the scale, of the error that is new in every sample."""
    lasting_sigma: Float[np.ndarray, "3"] = np.zeros(3)
    """Of the error that it shares with the samples before."""
    lasts_s: Float[np.ndarray, "3"] = np.ones(3)
    """After this time 1/e of a shared error is left."""
