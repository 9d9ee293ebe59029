"""Fisheye whose radius is a full polynomial of the angle, as WoodScape's `radial_poly` (room: cameras; pure JAX).

In: points `p_cam`, also beside and behind the lens. Out: model coordinates = distorted angle x direction.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from semloc_jax.cameras.base import Camera, Scalar, as_leaf
from semloc_jax.cameras.elementwise import MIN_SLOPE, angle_of, at_most, derivative, horner
from semloc_jax.cameras.fisheye import LARGEST_THETA_RAD

_TINY_M2 = 1e-12  # (1 um)^2: keeps direction and derivative finite on the axis
_NEWTON_STEPS = 14


class PolynomialFisheyeCamera(Camera):
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
            max_theta_rad = _usable_angle(self._slope())
        self.max_theta_rad = as_leaf(max_theta_rad)

    def _slope(self) -> tuple:
        return derivative((0.0, 1.0, self.c2, self.c3, self.c4))

    def _distorted(self, theta: Array) -> Array:
        inner = at_most(theta, self.max_theta_rad)
        end_slope = horner(self._slope(), self.max_theta_rad)
        return inner * horner((1.0, self.c2, self.c3, self.c4), inner) + end_slope * (theta - inner)

    def _to_model(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        r2 = x * x + y * y + _TINY_M2
        inverse_r = jax.lax.rsqrt(r2)
        theta = angle_of(r2 * inverse_r, z)
        scale = self._distorted(theta) * inverse_r
        return x * scale, y * scale, theta < self.max_theta_rad

    def _from_model(self, xm: Array, ym: Array) -> tuple[Array, Array, Array, Array]:
        target2 = xm * xm + ym * ym + _TINY_M2
        inverse_target = jax.lax.rsqrt(target2)
        target = target2 * inverse_target

        def step(_: ArrayLike, theta: Array) -> Array:
            inner = at_most(theta, self.max_theta_rad)
            return theta - (self._distorted(theta) - target) / horner(self._slope(), inner)

        theta = jax.lax.fori_loop(0, _NEWTON_STEPS, step, jnp.minimum(target, self.max_theta_rad))
        error = jnp.abs(self._distorted(theta) - target)
        valid = (error < 1e2 * jnp.finfo(xm.dtype).eps) & (theta < self.max_theta_rad)
        scale = jnp.sin(theta) * inverse_target
        return xm * scale, ym * scale, jnp.cos(theta), valid


def _usable_angle(slope: tuple) -> float:
    """Angle up to which a polynomial of this slope rises with at least MIN_SLOPE; at most LARGEST_THETA_RAD."""
    polynomial = np.array([float(c) for c in slope])
    polynomial[0] -= MIN_SLOPE
    roots = np.polynomial.polynomial.polyroots(np.trim_zeros(polynomial, "b"))
    turning = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return float(min(turning.min(), LARGEST_THETA_RAD)) if turning.size else float(LARGEST_THETA_RAD)
