"""Factors of vehicle poses over time: measured pose, motion between poses, satellite fix (room: residuals; pure JAX).

In: T_map_base [4 4] of one or two times, what was measured, sqrt_info. Out: whitened residual vectors.
A residual is zero where the poses agree with the measurement; half its squared norm is the cost in nats.
"""

from collections.abc import Callable
from functools import cache, partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.geometry import lie
from semloc_jax.residuals.robust import CAUCHY_SCALE, LOSSES


def pose_residual(
    T_map_base: Float[Array, "4 4"], T_measured: Float[Array, "4 4"], sqrt_info: Float[Array, "k 6"]
) -> Float[Array, " k"]:
    """Whitened difference of a pose from its measurement, in the right tangent of the measurement.

    `sqrt_info` [k 6] holds one row for each independent observation: six for a full pose; three that look at x, y and
    yaw for a planar one.
    """
    return _mul(sqrt_info, lie.log(lie.compose(lie.inverse(T_measured), T_map_base)))


def between_residual(
    T_map_from: Float[Array, "4 4"],
    T_map_to: Float[Array, "4 4"],
    T_from_to: Float[Array, "4 4"],
    sqrt_info: Float[Array, "k 6"],
) -> Float[Array, " k"]:
    """Whitened difference of the motion between two poses from the measured one; `sqrt_info` as in `pose_residual`."""
    return pose_residual(lie.compose(lie.inverse(T_map_from), T_map_to), T_from_to, sqrt_info)


def pulled_residual(
    T_map_element: Float[Array, "4 4"],
    T_map_base: Float[Array, "4 4"],
    metre: Float[Array, "1"],
    T_element_base: Float[Array, "4 4"],
    offset: Float[Array, " k"],
    sqrt_info: Float[Array, "k 6"],
) -> Float[Array, " k"]:
    """Whitened pull of a map element on a vehicle: `between_residual` that is not zero where it was measured.

    Half its square is the cost of the element around the pose T_element_base where the masks were compared: with R =
    `sqrt_info`, R^T R is the information there and R^T `offset` the force. What the masks leave open, such as the way
    along a line, has no row. The images show the vehicle farther from the element than it is by the share `metre`: so
    does a camera that stands a little lower than calibrated. It is a share of the way between them where the masks
    were compared, not of the one that is solved for: else the errors of single frames would cost less in a smaller
    world, and a way with many of them would shrink.
    """
    T_map_seen = _farther(T_map_element, T_map_base, metre, T_element_base)
    return between_residual(T_map_element, T_map_seen, T_element_base, sqrt_info) + offset


def metre_residual(metre: Float[Array, "1"], sqrt_info: Float[Array, "1"]) -> Float[Array, " 1"]:
    """Whitened share by which the metre of the images is off."""
    return sqrt_info * metre


def _farther(T_map_element: Array, T_map_base: Array, metre: Array, T_element_base: Array) -> Array:
    """Where images have the vehicle: moved away from the element by a share of the way that was between them."""
    return T_map_base.at[:3, 3].add(metre[0] * _mul(T_map_element[:3, :3], T_element_base[:3, 3]))


def odometry_residual(
    T_map_from: Float[Array, "4 4"],
    T_map_to: Float[Array, "4 4"],
    calibration_change: Float[Array, " c"],
    T_from_to: Float[Array, "4 4"],
    jacobian: Float[Array, "6 c"],
    sqrt_info: Float[Array, "k 6"],
) -> Float[Array, " k"]:
    """`between_residual` of odometry whose calibration (scale, gyroscope bias, ...) is unknown too.

    Args:
        T_map_from: Pose at the start.
        T_map_to: Pose at the end.
        calibration_change: The calibration less the one that the odometry was made with.
        T_from_to: Motion that the odometry says.
        jacobian: Derivative of its right tangent by the calibration.
        sqrt_info: One row for each independent observation.
    """
    corrected = lie.compose(T_from_to, lie.exp(_mul(jacobian, calibration_change)))
    return between_residual(T_map_from, T_map_to, corrected, sqrt_info)


def fix_residual(
    T_map_base: Float[Array, "4 4"],
    offset: Float[Array, "2"],
    p_base: Float[Array, "3"],
    fix: Float[Array, "2"],
    sqrt_info: Float[Array, "2"],
) -> Float[Array, "2"]:
    """Whitened horizontal difference of a point of the vehicle from a satellite fix that is off by `offset` [m].

    Args:
        T_map_base: Pose of the vehicle.
        offset: GNSS-to-map offset, east and north.
        p_base: The point: antenna, or the way driven since the time of the pose.
        fix: Position that the receiver gives, east and north.
        sqrt_info: 1 / standard deviation [1/m]; 0 for no fix.
    """
    return (lie.transform(T_map_base, p_base)[:2] + offset - fix) * sqrt_info


def level_residual(
    T_map_base: Float[Array, "4 4"], up_base: Float[Array, "3"], sqrt_info: Float[Array, "2"]
) -> Float[Array, "2"]:
    """Whitened difference of the vertical of the map, seen from the vehicle, from the measured one: pitch and roll.

    Args:
        T_map_base: Pose in a map whose z is up.
        up_base: Unit direction against gravity.
        sqrt_info: 1 / standard deviation of each of its first two coordinates [1/rad]; 0 where nothing was measured.
    """
    return (T_map_base[2, :2] - up_base[:2]) * sqrt_info


def pose_linearised(
    T_map_base: Float[Array, "4 4"], T_measured: Float[Array, "4 4"], sqrt_info: Float[Array, "k 6"]
) -> tuple[Float[Array, " k"], Float[Array, "k 6"]]:
    """`pose_residual` and its derivative by the right tangent of the pose."""
    xi = lie.log(lie.compose(lie.inverse(T_measured), T_map_base))
    return _mul(sqrt_info, xi), _mul(sqrt_info, lie.se3_right_jacobian_inverse(xi))


def between_linearised(
    T_map_from: Float[Array, "4 4"],
    T_map_to: Float[Array, "4 4"],
    T_from_to: Float[Array, "4 4"],
    sqrt_info: Float[Array, "k 6"],
) -> tuple[Float[Array, " k"], Float[Array, "k 6"], Float[Array, "k 6"]]:
    """`between_residual` and its derivatives by the right tangents of both poses."""
    T_moved = lie.compose(lie.inverse(T_map_from), T_map_to)
    r, J_to = pose_linearised(T_moved, T_from_to, sqrt_info)
    return r, -_mul(J_to, lie.adjoint(lie.inverse(T_moved))), J_to


def pulled_linearised(
    T_map_element: Float[Array, "4 4"],
    T_map_base: Float[Array, "4 4"],
    metre: Float[Array, "1"],
    T_element_base: Float[Array, "4 4"],
    offset: Float[Array, " k"],
    sqrt_info: Float[Array, "k 6"],
) -> tuple[Float[Array, " k"], Float[Array, "k 6"], Float[Array, "k 6"], Float[Array, "k 1"]]:
    """`pulled_residual` and its derivatives by the right tangents of element and vehicle, and by the metre."""
    T_map_seen = _farther(T_map_element, T_map_base, metre, T_element_base)
    r, J_element, J_seen = between_linearised(T_map_element, T_map_seen, T_element_base, sqrt_info)
    away = _mul(T_map_element[:3, :3], T_element_base[:3, 3])
    # An element that turns takes the way to the vehicle with it.
    J_place = _mul(J_seen[:, :3], T_map_base[:3, :3].T)
    J_turn = -metre[0] * _mul(J_place, _mul(T_map_element[:3, :3], lie.skew(T_element_base[:3, 3])))
    return r + offset, J_element.at[:, 3:].add(J_turn), J_seen, _mul(J_place, away)[:, None]


def odometry_linearised(
    T_map_from: Float[Array, "4 4"],
    T_map_to: Float[Array, "4 4"],
    calibration_change: Float[Array, " c"],
    T_from_to: Float[Array, "4 4"],
    jacobian: Float[Array, "6 c"],
    sqrt_info: Float[Array, "k 6"],
) -> tuple[Float[Array, " k"], Float[Array, "k 6"], Float[Array, "k 6"], Float[Array, "k c"]]:
    """`odometry_residual` and its derivatives by the right tangents of both poses and by the calibration.

    The last one holds to second order in jacobian x calibration_change.
    """
    T_moved = lie.compose(lie.inverse(T_map_from), T_map_to)
    change = _mul(jacobian, calibration_change)
    correction = lie.exp(change)
    r, J_to = pose_linearised(T_moved, lie.compose(T_from_to, correction), sqrt_info)
    J_from = -_mul(J_to, lie.adjoint(lie.inverse(T_moved)))
    T_to_measured = lie.compose(lie.inverse(T_moved), lie.compose(T_from_to, correction))
    # d exp(c) = exp(c) (1 - ad / 2 + ad^2 / 6 - ...) dc
    ad = lie.small_adjoint(change)
    by_calibration = jacobian - _mul(ad, jacobian / 2.0 - _mul(ad, jacobian / 6.0))
    return r, J_from, J_to, -_mul(J_to, _mul(lie.adjoint(T_to_measured), by_calibration))


def fix_linearised(
    T_map_base: Float[Array, "4 4"],
    offset: Float[Array, "2"],
    p_base: Float[Array, "3"],
    fix: Float[Array, "2"],
    sqrt_info: Float[Array, "2"],
) -> tuple[Float[Array, "2"], Float[Array, "2 6"], Float[Array, "2 2"]]:
    """`fix_residual` and its derivatives by the right tangent of the pose and by the offset."""
    R = T_map_base[:2, :3]
    by_pose = jnp.concatenate([R, -_mul(R, lie.skew(p_base))], axis=1)
    return fix_residual(T_map_base, offset, p_base, fix, sqrt_info), sqrt_info[:, None] * by_pose, jnp.diag(sqrt_info)


def level_linearised(
    T_map_base: Float[Array, "4 4"], up_base: Float[Array, "3"], sqrt_info: Float[Array, "2"]
) -> tuple[Float[Array, "2"], Float[Array, "2 6"]]:
    """`level_residual` and its derivative by the right tangent of the pose."""
    by_turn = lie.skew(T_map_base[2, :3])[:2]
    J = sqrt_info[:, None] * jnp.concatenate([jnp.zeros_like(by_turn), by_turn], axis=1)
    return level_residual(T_map_base, up_base, sqrt_info), J


def cauchy_cost(r: Float[Array, " k"], threshold: float) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Cauchy cost of a whitened residual, and the root of its weight in reweighted least squares.

    Half the squared norm near zero; beyond `threshold` the cost grows with the logarithm of the norm.
    """
    loss, scale = LOSSES["cauchy"], CAUCHY_SCALE / threshold
    v = scale * jnp.linalg.norm(r)
    return loss.rho(v) / scale**2, jnp.sqrt(loss.weight(v))


@cache
def cauchy(threshold: float) -> Callable[[Array], tuple[Array, Array]]:
    """`cauchy_cost` of one threshold; the same function object for the same threshold, so that it may be static."""
    return partial(cauchy_cost, threshold=threshold)


def _mul(A: Array, b: Array) -> Array:
    return jnp.matmul(A, b, precision=jax.lax.Precision.HIGHEST)
