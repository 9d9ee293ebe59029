"""A point of the map beside the pixel that is held to be it (room: residuals; pure JAX).

In: vehicle pose, a point, a line of sight. Out: offset in pixels, in the tangent plane of the line of sight.
It serves every camera model: straight edges are straight lines in that plane, whatever the lens.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_LEAST_COSINE = 0.1
"""Of the angle between measured and predicted ray: beyond it (84 deg) the offset grows no faster."""


class PointSight(NamedTuple):
    """A measured pixel of one camera."""

    T_base_cam: Float[Array, "4 4"]
    ray_cam: Float[Array, "3"]
    """Its line of sight, unit length."""
    pixels: Float[Array, "2 3"]
    """Direction beside the ray to pixels, see `perception.sight_lines`."""


def seen_beside(
    T_map_base: Float[Array, "4 4"], point_map: Float[Array, "3"], sight: PointSight
) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Where a point of the map is seen, less the measured pixel [px], and its distance from the camera [m]."""
    p_base = _mul(T_map_base[:3, :3].T, point_map - T_map_base[:3, 3])
    q = _mul(sight.T_base_cam[:3, :3].T, p_base - sight.T_base_cam[:3, 3])
    distance = jnp.linalg.norm(q)
    depth = jnp.maximum(jnp.dot(sight.ray_cam, q), _LEAST_COSINE * distance)
    return _mul(sight.pixels, q) / depth, distance


def shift_residual(shift_m: Float[Array, "3"], sqrt_info: Float[Array, "3"]) -> Float[Array, "3"]:
    """How far a landmark is from where the map has it [m], over its standard deviation."""
    return sqrt_info * shift_m


def _mul(A: Array, b: Array) -> Array:
    return jnp.matmul(A, b, precision=jax.lax.Precision.HIGHEST)
