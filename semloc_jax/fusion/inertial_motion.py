"""Motion between two times by the inertial sensor alone (room: fusion; host around JAX).

In: samples of rates and forces, what is known of the vehicle at the begin. Out: InertialMotion, T_from_to of it.
Without wheels a motion depends on where it begins: on the velocity, on the vertical and on the biases.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from semloc_jax.fusion.inertial_samples import Steps
from semloc_jax.geometry import rigid
from semloc_jax.residuals.preintegration import Preintegrated, preintegrate
from semloc_jax.structs import InertialNoise

GRAVITY_MAP = np.array([0.0, 0.0, -9.81])
_PADDED_TO = 32
"""Steps are padded to a multiple of this, so that few programs serve all intervals."""


class Moving(NamedTuple):
    """How a vehicle moves at some time, as far as its inertial sensor does not say it."""

    R_map_base: Float[np.ndarray, "3 3"]
    velocity_map: Float[np.ndarray, "3"]
    bias: Float[np.ndarray, "6"]
    """Of gyroscope [rad/s] and accelerometer [m/s^2]."""
    velocity_covariance: Float[np.ndarray, "3 3"]
    R_base_imu: Float[np.ndarray, "3 3"] = np.eye(3)
    """What is left of the mount of the sensor: its samples are given in the axes of the base already."""


class InertialMotion(NamedTuple):
    """What the inertial sensor says of an interval; errors are ordered (rotation, position, velocity) in the axes of
    `Preintegrated`."""

    rotation: Float[np.ndarray, "3 3"]
    position: Float[np.ndarray, "3"]
    velocity: Float[np.ndarray, "3"]
    duration_s: float
    covariance: Float[np.ndarray, "9 9"]
    by_bias: Float[np.ndarray, "9 6"]
    noise: InertialNoise
    """Of the sensor: its biases change as it says."""

    def turned(self, R_base_imu: Float[np.ndarray, "3 3"]) -> "InertialMotion":
        """The motion of a base to which the sensor is turned: what is integrated turns with the samples."""
        R = R_base_imu
        return self._replace(rotation=R @ self.rotation @ R.T, position=R @ self.position, velocity=R @ self.velocity)

    @property
    def by_mount(self) -> Float[np.ndarray, "9 3"]:
        """Derivative by a small turn of the sensor against the base [rad]."""
        turn = self.rotation.T - np.eye(3)
        return np.concatenate([turn, -rigid.skew(self.position), -rigid.skew(self.velocity)])

    def after(self, moving: Moving) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "3"]]:
        """T_from_to and the velocity at the end in the map."""
        fallen = moving.velocity_map * self.duration_s + 0.5 * GRAVITY_MAP * self.duration_s**2
        T_from_to = np.eye(4)
        T_from_to[:3, :3] = self.rotation
        T_from_to[:3, 3] = moving.R_map_base.T @ fallen + self.position
        velocity = moving.velocity_map + GRAVITY_MAP * self.duration_s + moving.R_map_base @ self.velocity
        return rigid.normalised(T_from_to), velocity

    def covariance_after(self, moving: Moving) -> Float[np.ndarray, "6 6"]:
        """Of the right tangent of T_from_to: noise of the sensor, doubt about the velocity."""
        back = self.rotation.T
        by_noise = np.zeros((6, 9))
        by_noise[:3, 3:6], by_noise[3:, :3] = back, np.eye(3)
        found = by_noise @ self.covariance @ by_noise.T
        by_velocity = self.duration_s * back @ moving.R_map_base.T
        found[:3, :3] += by_velocity @ moving.velocity_covariance @ by_velocity.T
        return found


def inertial_motion(steps: Steps, bias: Float[np.ndarray, "6"], noise: InertialNoise) -> InertialMotion:
    """The steps put together.

    Args:
        steps: Without padding, or with it.
        bias: Of gyroscope and accelerometer, taken off.
        noise: Of the sensor.
    """
    pad = -len(steps.step_s) % _PADDED_TO
    gyro, accel = (np.pad(rows, ((0, pad), (0, 0))) for rows in (steps.gyro_radps, steps.accel_mps2))
    with jax.enable_x64(True):
        found = _preintegrated(gyro, accel, np.pad(steps.step_s, (0, pad)), np.asarray(bias, float), noise)
        found = jax.tree.map(np.asarray, found)
    return InertialMotion(
        found.rotation, found.position, found.velocity, float(found.duration_s), found.covariance, found.by_bias, noise
    )


@jax.jit
def _preintegrated(gyro, accel, step_s, bias, noise: InertialNoise) -> Preintegrated:
    return preintegrate(gyro, accel, step_s, bias, noise)
