"""What is known of vehicle poses over time, as factors (room: fusion; pure JAX).

In: measured poses, odometry, satellite fixes, a prior. Out: families of factors for a `FactorGraph`.
Its variables are the poses T_map_base ("pose"), odometer scale, gyroscope bias [rad/s] and direction of travel [rad]
("odometer"), and the GNSS-to-map offset east, north [m] ("gnss"). Where they span more than some metres, use float64.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.residuals.motion import (
    between_linearised,
    between_residual,
    cauchy,
    fix_linearised,
    fix_residual,
    level_linearised,
    level_residual,
    odometry_linearised,
    odometry_residual,
    pose_linearised,
    pose_residual,
)
from semloc_jax.solvers.factors import POSE, Factors, vector
from semloc_jax.solvers.graph import FactorGraph, Family, Values
from semloc_jax.solvers.levenberg_marquardt import SolveConfig

ODOMETER = vector(0.05, 0.01, 0.01)
GNSS = vector(5.0, 5.0)


@dataclass(frozen=True)
class GraphConfig:
    """How poses over time are solved. All values are ours."""

    pose_threshold: float = 4.0
    """Norm of a whitened pose difference (6 numbers) beyond which its pull grows no more."""
    fix_threshold: float = 2.0
    tolerance: float = 2e-4
    """A solve ends when a step is below this share of 0.5 m, 0.05 rad and the units of the calibration."""
    max_steps: int = 20

    @property
    def solve(self) -> SolveConfig:
        """The same for the solver."""
        return SolveConfig(self.tolerance, self.max_steps)


def families(num: int) -> tuple[Family, ...]:
    """The variables of so many poses and one calibration."""
    return Family("pose", POSE, num), Family("odometer", ODOMETER, 1), Family("gnss", GNSS, 1)


def values_of(Ts_map_base: Float[Array | np.ndarray, "n 4 4"], calibration: Float[Array | np.ndarray, "5"]) -> Values:
    """Values of the variables; calibration: scale, bias [rad/s], travel [rad], offset east, north [m]."""
    return {"pose": Ts_map_base, "odometer": calibration[None, :3], "gnss": calibration[None, 3:]}


def calibration_of(values: Values) -> Float[Array, "5"]:
    """Scale, bias [rad/s], travel [rad], offset east, north [m]."""
    return jnp.concatenate([values["odometer"][0], values["gnss"][0]])


def pose_graph(is_used: Bool[Array | np.ndarray, " n"], factors: tuple[Factors, ...]) -> FactorGraph:
    """The graph of poses and one calibration; poses that are not used stay where they are."""
    num = len(is_used)
    return FactorGraph(families(num), factors, {"pose": is_used[:, None] & np.ones(POSE.size, bool)})


def measured_poses(
    T_measured: Float[Array | np.ndarray, "n 4 4"], sqrt_info: Float[Array | np.ndarray, "n 6 6"], threshold: float
) -> Factors:
    """A measured pose of every pose of the graph; `sqrt_info` 0 where there is none."""
    keys = (np.arange(len(T_measured)),)
    robust = cauchy(threshold)
    return Factors(pose_residual, ("pose",), keys, (T_measured,), sqrt_info, robust=robust, linearised=pose_linearised)


def odometry(
    start: Int[Array | np.ndarray, " e"],
    end: Int[Array | np.ndarray, " e"],
    T_start_end: Float[Array | np.ndarray, "e 4 4"],
    jacobian: Float[Array | np.ndarray, "e 6 3"],
    made_with: Float[Array | np.ndarray, "e 3"],
    sqrt_info: Float[Array | np.ndarray, "e 6 6"],
) -> Factors:
    """Motion between two poses by wheels and gyroscope.

    Args:
        start, end: The poses.
        T_start_end: The motion.
        jacobian: Derivative of its right tangent by scale, bias and direction of travel.
        made_with: Scale, bias [rad/s] and direction of travel [rad] that it was made with.
        sqrt_info: 0 where there is no motion.
    """
    return Factors(
        _odometry_residual,
        ("pose", "pose", "odometer"),
        (start, end, np.zeros_like(start)),
        (T_start_end, jacobian, made_with),
        sqrt_info,
        linearised=_odometry_linearised,
    )


def fixes(
    p_fix: Float[Array | np.ndarray, "n 2"],
    p_base: Float[Array | np.ndarray, "n 3"],
    sqrt_info: Float[Array | np.ndarray, "n 2"],
    threshold: float,
    poses: Int[Array | np.ndarray, " n"] | None = None,
) -> Factors:
    """Satellite fixes of the point `p_base` of the vehicle; `sqrt_info` 0 where there is none.

    `poses`: which pose each one is of; None for one of every pose of the graph.
    """
    keys = (np.arange(len(p_fix)) if poses is None else poses, np.zeros(len(p_fix), int))
    data, robust = (p_base, p_fix), cauchy(threshold)
    return Factors(fix_residual, ("pose", "gnss"), keys, data, sqrt_info, robust=robust, linearised=fix_linearised)


def verticals(
    poses: Int[np.ndarray, " n"], up_base: Float[np.ndarray, "n 3"], sqrt_info: Float[np.ndarray, "n 2"]
) -> Factors:
    """The direction against gravity that was measured in poses; the map is level."""
    return Factors(level_residual, ("pose",), (poses,), (up_base,), sqrt_info, linearised=level_linearised)


def motions(
    start: Int[np.ndarray, " e"],
    end: Int[np.ndarray, " e"],
    Ts_start_end: Float[np.ndarray, "e 4 4"],
    sqrt_info: Float[np.ndarray, "e 6 6"],
) -> Factors:
    """Motion between any two poses, such as a loop."""
    return Factors(
        between_residual, ("pose", "pose"), (start, end), (Ts_start_end,), sqrt_info, linearised=between_linearised
    )


def prior(
    T_prior: Float[Array | np.ndarray, "4 4"],
    calibration: Float[Array | np.ndarray, "5"],
    sqrt_info: Float[Array | np.ndarray, "11 11"],
) -> Factors:
    """What is known of the first pose and of the calibration together, beside the other factors."""
    keys = (np.zeros(1, int),) * 3
    on, data = ("pose", "odometer", "gnss"), (T_prior[None], calibration[None])
    return Factors(_prior_residual, on, keys, data, sqrt_info[None], linearised=_prior_linearised)


def _odometry_residual(T_from, T_to, odometer, T_start_end, jacobian, made_with, sqrt_info) -> Float[Array, " k"]:
    return odometry_residual(T_from, T_to, odometer - made_with, T_start_end, jacobian, sqrt_info)


def _odometry_linearised(T_from, T_to, odometer, T_start_end, jacobian, made_with, sqrt_info) -> tuple[Array, ...]:
    return odometry_linearised(T_from, T_to, odometer - made_with, T_start_end, jacobian, sqrt_info)


def _prior_residual(T, odometer, offset, T_prior, calibration, sqrt_info) -> Float[Array, " k"]:
    off = pose_residual(T, T_prior, jnp.eye(6, dtype=T.dtype))
    return _mul(sqrt_info, jnp.concatenate([off, jnp.concatenate([odometer, offset]) - calibration]))


def _prior_linearised(T, odometer, offset, T_prior, calibration, sqrt_info) -> tuple[Array, ...]:
    _, J = pose_linearised(T, T_prior, jnp.eye(6, dtype=T.dtype))
    r = _prior_residual(T, odometer, offset, T_prior, calibration, sqrt_info)
    return r, _mul(sqrt_info[:, :6], J), sqrt_info[:, 6:9], sqrt_info[:, 9:]


def _mul(A: Array, b: Array) -> Array:
    return jnp.matmul(A, b, precision=jax.lax.Precision.HIGHEST)
