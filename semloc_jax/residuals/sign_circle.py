"""The centre and the radius of a round sign against those that a mask shows (room: residuals; pure JAX).

In: vehicle pose, centre and radius in the map, the ellipse that was seen. Out: whitened offsets of both.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.residuals.seen_point import PointSight, seen_beside


def circle_residual(
    T_map_base: Float[Array, "4 4"],
    centre_map: Float[Array, "3"],
    radius_m: Float[Array, ""],
    sight: PointSight,
    radius_px: Float[Array, ""],
    sqrt_info: Float[Array, "3"],
) -> Float[Array, "3"]:
    """Whitened offset of the centre, and seen radius less measured one [px / sigma].

    A disc that is turned away is seen as an ellipse whose longer half axis stays what its distance makes of the radius.

    Args:
        T_map_base: Vehicle pose.
        centre_map: Centre of the disc [m].
        radius_m: Its radius.
        sight: The pixel of the centre.
        radius_px: Longer half axis of the ellipse.
        sqrt_info: 1 / standard deviations of column, row and radius [1/px]; 0 for a patch of unknown shape.
    """
    off, distance = seen_beside(T_map_base, centre_map, sight)
    px_per_rad = jnp.sqrt(jnp.linalg.norm(jnp.cross(sight.pixels[0], sight.pixels[1])))
    return sqrt_info * jnp.append(off, radius_m / distance * px_per_rad - radius_px)
