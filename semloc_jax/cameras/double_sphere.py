"""Fisheye of two spheres (Kalibr `ds`, Basalt) (room: cameras; pure JAX).

In: points `p_cam`, also beside and behind the lens. Out: model coordinates = distorted radius x direction.
"""

from types import ModuleType

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from semloc_jax.cameras.base import Scalar, as_leaf, number
from semloc_jax.cameras.elementwise import MIN_SLOPE
from semloc_jax.cameras.radial import LARGEST_THETA_RAD, RadialCamera


class DoubleSphereCamera(RadialCamera):
    """Fisheye: u = fx sin(theta) / (alpha d + (1 - alpha) (xi + cos(theta))) x / r + cx, d^2 = sin^2 + (xi + cos)^2.

    theta is the angle to the optical axis, r the distance from it (Usenko, Demmel and Cremers 2018, eq. 40 to 42).
    Beyond `max_theta_rad` the radius continues linearly and `valid` is False.
    """

    xi: Scalar = number(0.0)
    alpha: Scalar = number(0.5)
    max_theta_rad: Scalar = number(None)

    def __post_init__(self) -> None:
        """Without `max_theta_rad`: the angle at which the radius is about to turn, at most LARGEST_THETA_RAD."""
        if self.max_theta_rad is None:
            self.max_theta_rad = as_leaf(_usable_angle(float(self.xi), float(self.alpha)))

    def _radius(self, theta: Array) -> Array:
        return _radius(theta, self.xi, self.alpha, jnp)


def _radius(theta: ArrayLike, xi: ArrayLike, alpha: ArrayLike, xp: ModuleType) -> Array | np.ndarray:
    """Radius of an angle, of NumPy or JAX."""
    ahead = xi + xp.cos(theta)
    second = xp.sqrt(1.0 + xi * xi + 2.0 * xi * xp.cos(theta))
    return xp.sin(theta) / (alpha * second + (1.0 - alpha) * ahead)


def _usable_angle(xi: float, alpha: float) -> float:
    """Angle up to which the radius rises with at least MIN_SLOPE of its slope at the centre; at most
    LARGEST_THETA_RAD."""
    theta = np.linspace(0.0, LARGEST_THETA_RAD, 4001)
    radius = _radius(theta, xi, alpha, np)
    least = MIN_SLOPE * radius[1] / theta[1]
    rises = np.diff(radius) >= least * np.diff(theta)
    return float(theta[-1] if rises.all() else theta[np.argmin(rises)])
