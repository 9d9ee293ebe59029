"""Lenses that are symmetric about their axis and may see beyond 90 deg (room: cameras; pure JAX).

In: the radius of the image as a function of the angle to the axis. Out: a Camera that keeps the contract: no folding
back beyond the view, finite everywhere, inverted by Newton's method.
"""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

from semloc_jax.cameras.base import Camera, Scalar
from semloc_jax.cameras.elementwise import angle_of, at_most

LARGEST_THETA_RAD = 2.0
"""Half field of view that is assumed where neither the model nor the caller limits it (115 deg)."""
_TINY_M2 = 1e-12  # (1 um)^2: keeps direction and derivative finite on the axis
_NEWTON_STEPS = 14


class RadialCamera(Camera):
    """A lens with u = fx radius(theta) x / r + cx: theta is the angle to the optical axis, r the distance from it.

    A subclass gives `_radius`, near theta for small angles and rising up to `max_theta_rad`. Beyond it the radius
    continues linearly and `valid` is False.
    """

    max_theta_rad: eqx.AbstractVar[Scalar]

    @abstractmethod
    def _radius(self, theta: Array) -> Array:
        """Radius in the image [model units] of angles from 0 to `max_theta_rad`; elementwise."""

    def _slope(self, theta: Array) -> Array:
        """Derivative of `_radius`; a subclass may know it in closed form."""
        theta = jnp.asarray(theta)
        return jax.jvp(self._radius, (theta,), (jnp.ones_like(theta),))[1]

    def _distorted(self, theta: Array) -> Array:
        inner = at_most(theta, self.max_theta_rad)
        return self._radius(inner) + self._slope(self.max_theta_rad) * (theta - inner)

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
            return theta - (self._distorted(theta) - target) / self._slope(at_most(theta, self.max_theta_rad))

        theta = jax.lax.fori_loop(0, _NEWTON_STEPS, step, jnp.minimum(target, self.max_theta_rad))
        error = jnp.abs(self._distorted(theta) - target)
        valid = (error < 1e2 * jnp.finfo(xm.dtype).eps) & (theta < self.max_theta_rad)
        scale = jnp.sin(theta) * inverse_target
        return xm * scale, ym * scale, jnp.cos(theta), valid
