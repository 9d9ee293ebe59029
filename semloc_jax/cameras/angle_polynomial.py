"""Fisheye whose radius is a full polynomial of the angle, as WoodScape's `radial_poly` (room: cameras; pure JAX).

In: points `p_cam`, also beside and behind the lens. Out: model coordinates = distorted angle x direction.
"""

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from semloc_jax.cameras.base import Scalar, as_leaf
from semloc_jax.cameras.elementwise import MIN_SLOPE, derivative, horner, positive_roots
from semloc_jax.cameras.radial import LARGEST_THETA_RAD, RadialCamera


class PolynomialFisheyeCamera(RadialCamera):
    """Fisheye: theta_d = theta (1 + c2 theta + c3 theta^2 + c4 theta^3), u = fx theta_d x / r + cx.

    theta is the angle to the optical axis, r the distance from it. WoodScape writes rho = k1 theta + k2 theta^2 + ...
    in pixels: fx = k1 and cN = kN / k1. Beyond `max_theta_rad` theta_d continues linearly and `valid` is False.
    """

    fx: Scalar
    fy: Scalar
    cx: Scalar
    cy: Scalar
    width: Scalar
    height: Scalar
    c2: Scalar
    c3: Scalar
    c4: Scalar
    max_theta_rad: Scalar

    def __init__(
        self,
        fx: ArrayLike,
        fy: ArrayLike,
        cx: ArrayLike,
        cy: ArrayLike,
        width: ArrayLike,
        height: ArrayLike,
        c2: ArrayLike = 0.0,
        c3: ArrayLike = 0.0,
        c4: ArrayLike = 0.0,
        max_theta_rad: ArrayLike | None = None,
    ) -> None:
        """Focal lengths and centre [px], image size [px], polynomial, half field of view [rad].

        `max_theta_rad` None takes the angle at which the polynomial is about to turn, at most LARGEST_THETA_RAD.
        """
        self.fx, self.fy, self.cx, self.cy = as_leaf(fx), as_leaf(fy), as_leaf(cx), as_leaf(cy)
        self.width, self.height = as_leaf(width), as_leaf(height)
        self.c2, self.c3, self.c4 = (as_leaf(c) for c in (c2, c3, c4))
        if max_theta_rad is None:
            max_theta_rad = _usable_angle(derivative(self._polynomial()))
        self.max_theta_rad = as_leaf(max_theta_rad)

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
