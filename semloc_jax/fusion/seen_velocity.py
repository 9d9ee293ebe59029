"""The velocity of a vehicle by its window, and for how long its error lasts (room: fusion; host).

In: the newest and the oldest state of a window. Out: VelocitySample.
A window learns its scale and its vertical slowly: what its velocity is off by at one image it is still off by seconds
later. How much of it is left the window says itself: the error of a state when it was the newest is, but for what later
images told, that of the same state now, and what later images tell is no longer in the error of the newest. So the
covariance of both states now is that of both velocities as they were given.
"""

import numpy as np
from jaxtyping import Float

from semloc_jax.fusion.inertial_states import AT
from semloc_jax.fusion.inertial_window import InertialEstimate, MotionState
from semloc_jax.fusion.velocity_sample import VelocitySample
from semloc_jax.geometry import rigid

NEW_SIGMA_MPS = (0.05, 0.05, 0.1)
"""Of a velocity by a window, ahead, left and up, that is another one at every image: vibration and suspension between
images. Ours."""
_LONGEST_S, _SHORTEST_S = 60.0, 0.1
"""An error lasts between these: no window of a second tells a longer time."""


def seen_velocity(estimate: InertialEstimate) -> VelocitySample:
    """The velocity of the newest state of a window, in the axes of the vehicle."""
    slope, slope_then = _by_state(estimate.state), _by_state(estimate.oldest)
    variance = np.diag(slope @ estimate.covariance @ slope.T)
    shared = np.diag(slope @ estimate.across_oldest @ slope_then.T)
    # A velocity is as well known as when the oldest state was the newest.
    left = np.clip(shared / variance, 1e-9, 1.0 - 1e-9)
    lasts_s = np.clip(-(estimate.time_s - estimate.oldest_s) / np.log(left), _SHORTEST_S, _LONGEST_S)
    velocity = estimate.state.T_map_base[:3, :3].T @ estimate.state.velocity_map
    return VelocitySample(velocity, np.array(NEW_SIGMA_MPS), np.sqrt(variance), lasts_s)


def _by_state(state: MotionState) -> Float[np.ndarray, "3 22"]:
    """Derivative of the velocity in the axes of the vehicle by the error of a state."""
    R = state.T_map_base[:3, :3]
    slope = np.zeros((3, AT["delay"].stop))
    slope[:, 3:6], slope[:, AT["velocity"]] = rigid.skew(R.T @ state.velocity_map), R.T
    return slope
