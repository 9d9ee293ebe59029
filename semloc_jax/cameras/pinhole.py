"""Pinhole cameras without and with Brown-Conrady (radtan) distortion (room: cameras; pure JAX).

In: points `p_cam`. Out: model coordinates = tangents of the angles to the optical axis.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

from semloc_jax.cameras.base import Camera, Scalar, as_leaf, number
from semloc_jax.cameras.elementwise import at_least, at_most, derivative, horner, usable_radius

MIN_DEPTH_M = 1e-2
"""Points nearer to the plane of the lens are not projected; their pixel is that of the plane at this depth."""
_LARGEST_RADIUS = 10.0  # tan of 84 deg; no radtan lens sees further
_NEWTON_STEPS = 12


class PinholeCamera(Camera):
    """Ideal pinhole: u = fx x / z + cx; focal lengths, centre and image size in px."""

    def _to_model(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        inverse_depth = 1 / at_least(z, MIN_DEPTH_M)
        return x * inverse_depth, y * inverse_depth, z > MIN_DEPTH_M

    def _from_model(self, xm: Array, ym: Array) -> tuple[Array, Array, Array, Array]:
        return *_unit(xm, ym), jnp.isfinite(xm + ym)


class BrownConradyCamera(Camera):
    """Pinhole with radial (k1, k2, k3) and tangential (p1, p2) distortion, as OpenCV's k1 k2 p1 p2 k3.

    Beyond `max_radius` (where the radial polynomial is about to turn) the distortion continues monotonically, ever more
    like a straight line, and `valid` is False.
    """

    k1: Scalar = number(0.0)
    k2: Scalar = number(0.0)
    p1: Scalar = number(0.0)
    p2: Scalar = number(0.0)
    k3: Scalar = number(0.0)
    max_radius: Scalar = number(None)

    def __post_init__(self) -> None:
        """Find `max_radius` from k1 k2 k3 where it is not given."""
        if self.max_radius is None:
            self.max_radius = as_leaf(usable_radius(self._radial(), _LARGEST_RADIUS))

    def _radial(self) -> tuple:
        return 1.0, self.k1, self.k2, self.k3

    def _to_model(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        inverse_depth = 1 / at_least(z, MIN_DEPTH_M)
        x, y = x * inverse_depth, y * inverse_depth
        xm, ym, inside = self._distort(x, y)
        return xm, ym, inside & (z > MIN_DEPTH_M)

    def _distort(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        s = x * x + y * y
        limit = self.max_radius * self.max_radius
        inner = at_most(s, limit)
        # q is 1 inside and falls as (max_radius / r)^2 outside: it continues both terms once differentiably, the radial
        # one towards a straight line, the tangential one towards a bound, without a branch.
        q = limit / at_least(s, limit)
        radial = horner(self._radial(), inner) + limit * horner(derivative(self._radial()), limit) * (1 - q)
        tangential = q * (2 - q)
        xm = x * radial + tangential * (2 * self.p1 * x * y + self.p2 * (s + 2 * x * x))
        ym = y * radial + tangential * (self.p1 * (s + 2 * y * y) + 2 * self.p2 * x * y)
        return xm, ym, s < limit

    def _from_model(self, xm: Array, ym: Array) -> tuple[Array, Array, Array, Array]:
        def step(_: ArrayLike, xy: tuple[Array, Array]) -> tuple[Array, Array]:
            x, y = xy
            one, zero = jnp.ones_like(x), jnp.zeros_like(x)
            (fx, fy), (a, c) = jax.jvp(lambda *p: self._distort(*p)[:2], (x, y), (one, zero))
            _, (b, d) = jax.jvp(lambda *p: self._distort(*p)[:2], (x, y), (zero, one))
            ex, ey = fx - xm, fy - ym
            determinant = a * d - b * c
            return x - (d * ex - b * ey) / determinant, y - (a * ey - c * ex) / determinant

        x, y = jax.lax.fori_loop(0, _NEWTON_STEPS, step, (xm, ym))
        fx, fy, inside = self._distort(x, y)
        tolerance = 1e2 * jnp.finfo(xm.dtype).eps * (1 + jnp.abs(xm) + jnp.abs(ym))
        return *_unit(x, y), inside & (jnp.abs(fx - xm) + jnp.abs(fy - ym) < tolerance)


def _unit(x: Array, y: Array) -> tuple[Array, Array, Array]:
    scale = jax.lax.rsqrt(1 + x * x + y * y)
    return x * scale, y * scale, scale
