"""Fisheye of two spheres (Kalibr `ds`, Basalt) (room: cameras; pure JAX).

In: points `p_cam`, also beside and behind the lens. Out: model coordinates = distorted radius x direction.
"""

from types import ModuleType

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from semloc_jax.cameras.base import Scalar, as_leaf
from semloc_jax.cameras.elementwise import MIN_SLOPE
from semloc_jax.cameras.radial import LARGEST_THETA_RAD, RadialCamera


class DoubleSphereCamera(RadialCamera):
    """Fisheye: u = fx sin(theta) / (alpha d + (1 - alpha) (xi + cos(theta))) x / r + cx, d^2 = sin^2 + (xi + cos)^2.

    theta is the angle to the optical axis, r the distance from it (Usenko, Demmel and Cremers 2018, eq. 40 to 42).
    Beyond `max_theta_rad` the radius continues linearly and `valid` is False.
    """

    fx: Scalar
    fy: Scalar
    cx: Scalar
    cy: Scalar
    width: Scalar
    height: Scalar
    xi: Scalar
    alpha: Scalar
    max_theta_rad: Scalar

    def __init__(
        self,
        fx: ArrayLike,
        fy: ArrayLike,
        cx: ArrayLike,
        cy: ArrayLike,
        width: ArrayLike,
        height: ArrayLike,
        xi: ArrayLike = 0.0,
        alpha: ArrayLike = 0.5,
        max_theta_rad: ArrayLike | None = None,
    ) -> None:
        """Focal lengths and centre [px], image size [px], distance of the spheres, share of the second, half field of
        view [rad].

        `max_theta_rad` None takes the angle at which the radius is about to turn, at most LARGEST_THETA_RAD.
        """
        self.fx, self.fy, self.cx, self.cy = as_leaf(fx), as_leaf(fy), as_leaf(cx), as_leaf(cy)
        self.width, self.height = as_leaf(width), as_leaf(height)
        self.xi, self.alpha = as_leaf(xi), as_leaf(alpha)
        if max_theta_rad is None:
            max_theta_rad = _usable_angle(float(self.xi), float(self.alpha))
        self.max_theta_rad = as_leaf(max_theta_rad)

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
