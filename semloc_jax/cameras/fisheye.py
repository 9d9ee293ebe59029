"""Kannala-Brandt fisheye (Kalibr `equidistant`, cv2.fisheye) (room: cameras; pure JAX).

In: points `p_cam`, also beside and behind the lens. Out: model coordinates = distorted angle x direction.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

from semloc_jax.cameras.base import Camera, Scalar, as_leaf
from semloc_jax.cameras.elementwise import angle_of, at_most, horner, slope, usable_radius

LARGEST_THETA_RAD = 2.0
"""Half field of view that is assumed where neither the polynomial nor the caller limits it (115 deg)."""
_TINY_M2 = 1e-12  # (1 um)^2: keeps direction and derivative finite on the axis
_NEWTON_STEPS = 12


class KannalaBrandtCamera(Camera):
    """Fisheye: theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), u = fx theta_d x / r + cx.

    theta is the angle to the optical axis, r the distance from it. Beyond `max_theta_rad` theta_d continues linearly
    and `valid` is False.
    """

    fx: Scalar
    fy: Scalar
    cx: Scalar
    cy: Scalar
    width: Scalar
    height: Scalar
    k1: Scalar
    k2: Scalar
    k3: Scalar
    k4: Scalar
    max_theta_rad: Scalar

    def __init__(
        self,
        fx: ArrayLike,
        fy: ArrayLike,
        cx: ArrayLike,
        cy: ArrayLike,
        width: ArrayLike,
        height: ArrayLike,
        k1: ArrayLike = 0.0,
        k2: ArrayLike = 0.0,
        k3: ArrayLike = 0.0,
        k4: ArrayLike = 0.0,
        max_theta_rad: ArrayLike | None = None,
    ) -> None:
        """Focal lengths and centre [px], image size [px], distortion, half field of view [rad].

        `max_theta_rad` None takes the angle at which the polynomial is about to turn, at most LARGEST_THETA_RAD.
        """
        self.fx, self.fy, self.cx, self.cy = as_leaf(fx), as_leaf(fy), as_leaf(cx), as_leaf(cy)
        self.width, self.height = as_leaf(width), as_leaf(height)
        self.k1, self.k2, self.k3, self.k4 = (as_leaf(k) for k in (k1, k2, k3, k4))
        if max_theta_rad is None:
            max_theta_rad = usable_radius(self._radial(), LARGEST_THETA_RAD)
        self.max_theta_rad = as_leaf(max_theta_rad)

    def _radial(self) -> tuple:
        return 1.0, self.k1, self.k2, self.k3, self.k4

    def _distorted(self, theta: Array) -> Array:
        inner = at_most(theta, self.max_theta_rad)
        end_slope = horner(slope(self._radial()), self.max_theta_rad**2)
        return inner * horner(self._radial(), inner * inner) + end_slope * (theta - inner)

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
            return theta - (self._distorted(theta) - target) / horner(slope(self._radial()), inner * inner)

        theta = jax.lax.fori_loop(0, _NEWTON_STEPS, step, jnp.minimum(target, self.max_theta_rad))
        error = jnp.abs(self._distorted(theta) - target)
        valid = (error < 1e2 * jnp.finfo(xm.dtype).eps) & (theta < self.max_theta_rad)
        scale = jnp.sin(theta) * inverse_target
        return xm * scale, ym * scale, jnp.cos(theta), valid
