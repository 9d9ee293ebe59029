"""Inertial samples between two times as one factor (room: residuals; pure JAX).

In: angular rate and specific force of one interval, biases. Out: Preintegrated: motion, covariance, derivatives by the
biases; `imu_residual` of two states.
Preintegration on the manifold: Forster, Carlone, Dellaert, Scaramuzza, IEEE T-RO 2017, eqs. (33)-(44), (59)-(63).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.geometry import lie
from semloc_jax.structs import InertialNoise


class Preintegrated(eqx.Module):
    """Motion since the first time in the frame of the first base, free of the state there.

    Errors and derivatives are ordered (rotation [rad], position [m], velocity [m/s]); biases (gyroscope [rad/s],
    accelerometer [m/s^2]).
    """

    rotation: Float[Array, "3 3"]
    """R_from_to."""
    position: Float[Array, "3"]
    velocity: Float[Array, "3"]
    duration_s: Float[Array, ""]
    covariance: Float[Array, "9 9"]
    by_bias: Float[Array, "9 6"]
    bias: Float[Array, "6"]
    """Where `by_bias` holds."""
    by_delay: Float[Array, "9"]
    """Derivative of the motion by the time [s] at which its interval begins and ends."""

    def corrected(
        self, bias: Float[Array, "6"], later_s: Float[Array, ""] | float = 0.0
    ) -> tuple[Float[Array, "3 3"], Float[Array, "3"], Float[Array, "3"]]:
        """Rotation, position and velocity for another bias and an interval that lies so much later, to first order."""
        change = _mul(self.by_bias, bias - self.bias) + self.by_delay * later_s
        rotation = _mul(self.rotation, lie.so3_exp(change[:3]))
        return rotation, self.position + change[3:6], self.velocity + change[6:]


class InertialState(eqx.Module):
    """Pose and velocity of the base in the map frame."""

    T_map_base: Float[Array, "4 4"]
    velocity_map: Float[Array, "3"]
    """[m/s]."""


def preintegrate(
    gyro_radps: Float[Array, "n 3"],
    accel_mps2: Float[Array, "n 3"],
    step_s: Float[Array, " n"],
    bias: Float[Array, "6"],
    noise: InertialNoise | None = None,
) -> Preintegrated:
    """One factor of many inertial samples.

    Args:
        gyro_radps: Angular rates in the base frame.
        accel_mps2: Specific forces in the base frame.
        step_s: How long each sample holds; 0 is padding.
        bias: Of gyroscope and accelerometer.
        noise: None for the defaults.
    """
    noise, dtype = noise or InertialNoise(), gyro_radps.dtype
    identity, zero = jnp.eye(3, dtype=dtype), jnp.zeros((3, 3), dtype)
    densities = jnp.repeat(jnp.asarray([noise.gyro_density, noise.accel_density], dtype) ** 2, 3)

    def step(carry, sample):
        R, p, v, covariance, by_bias, last = carry
        rate, force, dt = sample[:3] - bias[:3], sample[3:6] - bias[3:], sample[6]
        turn, turn_jacobian = lie.so3_exp(rate * dt), lie.so3_right_jacobian(rate * dt) * dt
        push = -_mul(R, lie.skew(force))
        A = jnp.block(
            [
                [turn.T, zero, zero],
                [0.5 * push * dt**2, identity, identity * dt],
                [push * dt, zero, identity],
            ]
        )
        B = jnp.block([[turn_jacobian, zero], [zero, 0.5 * R * dt**2], [zero, R * dt]])
        # White noise of density d that is held for dt has the variance d^2 / dt; padding has none.
        variance = jnp.where(dt > 0, densities / jnp.where(dt > 0, dt, 1.0), 0.0)
        covariance = _mul(_mul(A, covariance), A.T) + _mul(B * variance, B.T)
        by_bias = _mul(A, by_bias) - B
        moved = _mul(R, force)
        last = jnp.where(dt > 0, jnp.stack([rate, moved]), last)
        return (_mul(R, turn), p + v * dt + 0.5 * moved * dt**2, v + moved * dt, covariance, by_bias, last), None

    start = (identity, zero[0], zero[0], jnp.zeros((9, 9), dtype), jnp.zeros((9, 6), dtype), zero[:2])
    samples = jnp.concatenate([gyro_radps, accel_mps2, step_s[:, None]], axis=1)
    (R, p, v, covariance, by_bias, (last_rate, last_force)), _ = jax.lax.scan(step, start, samples)
    rate, force, duration_s = gyro_radps[0] - bias[:3], accel_mps2[0] - bias[3:], jnp.sum(step_s)
    # What comes in at the end of the interval, less what leaves it at the begin, where its axes turn, too.
    by_delay = jnp.concatenate(
        [
            last_rate - _mul(R.T, rate),
            v - jnp.cross(rate, p) - force * duration_s,
            last_force - jnp.cross(rate, v) - force,
        ]
    )
    return Preintegrated(R, p, v, duration_s, covariance, by_bias, bias, by_delay)


def imu_residual(
    start: InertialState,
    end: InertialState,
    bias: Float[Array, "6"],
    gravity_map: Float[Array, "3"],
    factor: Preintegrated,
    sqrt_info: Float[Array, "9 9"],
    mount: Float[Array, "3"] | None = None,
    later_s: Float[Array, ""] | float = 0.0,
) -> Float[Array, "9"]:
    """Whitened difference of two states from what the inertial sensor says: (rotation, position, velocity).

    Args:
        start: State at the first time.
        end: State at the second.
        bias: Of gyroscope and accelerometer.
        gravity_map: Acceleration of free fall, (0, 0, -9.81) [m/s^2].
        factor: The samples between.
        sqrt_info: R with R^T R = inverse of `factor.covariance`.
        mount: Rotation vector that turns the samples into the axes of the base; None: they are given in them.
        later_s: How much later than `factor` the motion between the two times lies in the clock of the sensor.
    """
    R, p, v = factor.corrected(bias, later_s)
    if mount is not None:
        turn = lie.so3_exp(mount)
        R, p, v = _mul(_mul(turn, R), turn.T), _mul(turn, p), _mul(turn, v)
    R_base_map, dt = start.T_map_base[:3, :3].T, factor.duration_s
    turned = _mul(R.T, _mul(R_base_map, end.T_map_base[:3, :3]))
    fallen = start.velocity_map * dt + 0.5 * gravity_map * dt**2
    moved = _mul(R_base_map, end.T_map_base[:3, 3] - start.T_map_base[:3, 3] - fallen)
    gained = _mul(R_base_map, end.velocity_map - start.velocity_map - gravity_map * dt)
    return _mul(sqrt_info, jnp.concatenate([lie.so3_log(turned), moved - p, gained - v]))


def _mul(A: Array, b: Array) -> Array:
    return jnp.matmul(A, b, precision=jax.lax.Precision.HIGHEST)
