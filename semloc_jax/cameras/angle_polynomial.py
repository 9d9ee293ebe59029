"""Fisheye whose radius is a full polynomial of the angle, as WoodScape's `radial_poly` (room: cameras; pure JAX).

In: points `p_cam`, also beside and behind the lens. Out: model coordinates = distorted angle x direction.
"""

import numpy as np
from jaxtyping import Array

from semloc_jax.cameras.base import Scalar, as_leaf, number
from semloc_jax.cameras.elementwise import MIN_SLOPE, derivative, horner, positive_roots
from semloc_jax.cameras.radial import LARGEST_THETA_RAD, RadialCamera


class PolynomialFisheyeCamera(RadialCamera):
    """Fisheye: theta_d = theta (1 + c2 theta + c3 theta^2 + c4 theta^3), u = fx theta_d x / r + cx.

    theta is the angle to the optical axis, r the distance from it. WoodScape writes rho = k1 theta + k2 theta^2 + ...
    in pixels: fx = k1 and cN = kN / k1. Beyond `max_theta_rad` theta_d continues linearly and `valid` is False.
    """

    c2: Scalar = number(0.0)
    c3: Scalar = number(0.0)
    c4: Scalar = number(0.0)
    max_theta_rad: Scalar = number(None)

    def __post_init__(self) -> None:
        """Without `max_theta_rad`: the angle at which the polynomial is about to turn, at most LARGEST_THETA_RAD."""
        if self.max_theta_rad is None:
            self.max_theta_rad = as_leaf(_usable_angle(derivative(self._polynomial())))

    def _polynomial(self) -> tuple:
        return 0.0, 1.0, self.c2, self.c3, self.c4

    def _radius(self, theta: Array) -> Array:
        return horner(self._polynomial(), theta)

    def _slope(self, theta: Array) -> Array:
        return horner(derivative(self._polynomial()), theta)


def _usable_angle(slope: tuple) -> float:
    """Angle up to which a polynomial of this slope rises with at least MIN_SLOPE; at most LARGEST_THETA_RAD."""
    polynomial = np.array([float(c) for c in slope])
    polynomial[0] -= MIN_SLOPE
    turning = positive_roots(polynomial)
    return float(min(turning.min(), LARGEST_THETA_RAD)) if turning.size else float(LARGEST_THETA_RAD)
