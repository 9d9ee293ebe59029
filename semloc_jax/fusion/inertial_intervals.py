"""Inertial steps between the states of a window, put together once (room: fusion; host around JAX).

In: steps between two image times, the biases of the state before. Out: InertialInterval, and all of a window stacked.
Biases move little from one solve to the next, and to first order an interval holds at other biases than its own: to
put all of them together anew in every solve took as long as an evaluation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.fusion.inertial_motion import InertialMotion
from semloc_jax.fusion.inertial_samples import Steps
from semloc_jax.residuals.preintegration import Preintegrated, preintegrate
from semloc_jax.structs import InertialNoise

_SAME_BIAS = np.repeat([5e-4, 0.05], 3)
"""Biases of gyroscope [rad/s] and accelerometer [m/s^2] that differ by less share an interval: what is left out is of
second order, 1e-9 rad and 4e-9 m in 0.1 s."""


class InertialInterval(NamedTuple):
    """The steps between two states."""

    steps: Steps
    """Of which it was made."""
    moved: Preintegrated
    root: Float[np.ndarray, "9 9"]
    """R with R^T R = inverse of its covariance."""

    @classmethod
    def of(cls, steps: Steps, bias: Float[np.ndarray, "6"], noise: InertialNoise) -> "InertialInterval":
        """The steps put together at the biases of gyroscope and accelerometer."""
        with jax.enable_x64(True):
            moved, root = jax.tree.map(np.asarray, _together(*steps, np.asarray(bias, np.float64), noise))
        return cls(steps, moved, root)

    def holds(self, steps: Steps, bias: Float[np.ndarray, "6"]) -> bool:
        """Whether it was made of these steps, at nearly these biases."""
        return steps is self.steps and bool((np.abs(bias - self.moved.bias) <= _SAME_BIAS).all())

    def motion(self, noise: InertialNoise) -> InertialMotion:
        """What it says of the motion of a vehicle."""
        own = self.moved
        parts = own.rotation, own.position, own.velocity, float(own.duration_s), own.covariance, own.by_bias
        return InertialMotion(*parts, noise)


def stacked(intervals: Sequence[InertialInterval]) -> tuple[Preintegrated, Float[np.ndarray, "e 9 9"]]:
    """All of them with a leading axis, and their roots."""
    moved = jax.tree.map(lambda *parts: np.stack(parts), *(one.moved for one in intervals))
    return moved, np.stack([one.root for one in intervals])


@jax.jit
def _together(
    gyro: Array, accel: Array, step_s: Array, bias: Array, noise: InertialNoise
) -> tuple[Preintegrated, Float[Array, "9 9"]]:
    moved = preintegrate(gyro, accel, step_s, bias, noise)
    lower = jnp.linalg.cholesky(moved.covariance)
    return moved, jax.scipy.linalg.solve_triangular(lower, jnp.eye(9, dtype=lower.dtype), lower=True)
