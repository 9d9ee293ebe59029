"""Motion between frames whose turn is off by a scale and by a bias that wanders (room: mapping; host around JAX).

In: motions by wheels and gyroscope, their derivatives. Out: factors on poses, calibration ("odometer": scale of the
way, scale of the turn, direction of travel) and on what is left of the gyro bias at every frame ("wander", in standard
deviations). What a smoother leaves of a bias that walks stays the same for a while and is forgotten (an Ornstein and
Uhlenbeck process): over seconds a gyroscope is far better than over minutes.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.residuals.motion import odometry_linearised, odometry_residual
from semloc_jax.solvers.factors import Factors, vector
from semloc_jax.solvers.graph import Family

WANDER = vector(1.0)


def wanders(num: int) -> Family:
    """What is left of the bias at so many frames."""
    return Family("wander", WANDER, num)


def turning_odometry(
    Ts_from_to: Float[np.ndarray, "e 4 4"],
    jacobian: Float[np.ndarray, "e 6 4"],
    made_with: Float[np.ndarray, "3"],
    sqrt_info: Float[np.ndarray, "e 6 6"],
) -> Factors:
    """Motion between neighbouring frames.

    Args:
        Ts_from_to: the motion.
        jacobian: derivative of its right tangent [m, rad] by the calibration and by what is left of the bias.
        made_with: calibration that it was made with.
        sqrt_info: of the right tangent.
    """
    step = np.arange(len(Ts_from_to))
    return Factors(
        _turning_residual,
        ("pose", "pose", "odometer", "wander"),
        (step, step + 1, np.zeros_like(step), step),
        (Ts_from_to, jacobian, np.tile(made_with, (len(step), 1))),
        sqrt_info,
        linearised=_turning_linearised,
    )


def wandering(times_s: Float[np.ndarray, " n"], memory_s: float) -> tuple[Factors, Factors]:
    """How what is left of the bias goes on from frame to frame, and how large it is at first.

    Args:
        times_s: of the frames.
        memory_s: time after which 1/e of it is the same.
    """
    kept = np.exp(-np.diff(times_s) / memory_s)
    step = np.arange(len(kept))
    info = 1.0 / np.sqrt(-np.expm1(-2.0 * np.diff(times_s) / memory_s))
    on = Factors(_wander_residual, ("wander", "wander"), (step, step + 1), (kept,), info[:, None])
    first = Factors(_first_residual, ("wander",), (np.zeros(1, int),), (), np.ones((1, 1)))
    return on, first


def _turning_residual(T_from, T_to, odometer, wander, T_from_to, jacobian, made_with, sqrt_info) -> Float[Array, " k"]:
    change = jnp.concatenate([odometer - made_with, wander])
    return odometry_residual(T_from, T_to, change, T_from_to, jacobian, sqrt_info)


def _turning_linearised(T_from, T_to, odometer, wander, T_from_to, jacobian, made_with, sqrt_info) -> tuple[Array, ...]:
    change = jnp.concatenate([odometer - made_with, wander])
    r, J_from, J_to, J = odometry_linearised(T_from, T_to, change, T_from_to, jacobian, sqrt_info)
    return r, J_from, J_to, J[:, :3], J[:, 3:]


def _wander_residual(before: Array, after: Array, kept: Array, sqrt_info: Array) -> Float[Array, " 1"]:
    return sqrt_info * (after - kept * before)


def _first_residual(wander: Array, sqrt_info: Array) -> Float[Array, " 1"]:
    return sqrt_info * wander
