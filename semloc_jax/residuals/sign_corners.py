"""The corners of a sign against those that a mask shows (room: residuals; pure JAX).

In: vehicle pose, corners of a triangle (3) or rectangle (4) in the map, their pixels. Out: whitened offsets.
Which corner is which (the cyclic order) is settled by the association.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.residuals.seen_point import PointSight, seen_beside

MOST_CORNERS = 4


def corners_residual(
    T_map_base: Float[Array, "4 4"],
    corners_map: Float[Array, "4 3"],
    sights: PointSight,
    sqrt_info: Float[Array, "8 8"],
) -> Float[Array, "8"]:
    """Whitened offsets of the corners of one sign [px / sigma].

    Args:
        T_map_base: Vehicle pose.
        corners_map: Corners [m]; a triangle repeats one.
        sights: Their pixels, a leading axis over the corners.
        sqrt_info: Root of the information of all of them, column and row of each corner in turn [1/px]: a sign that the
            map has wrong is wrong at every corner. 0 for what is repeated.
    """
    off, _ = jax.vmap(seen_beside, (None, 0, 0))(T_map_base, corners_map, sights)
    return jnp.matmul(sqrt_info, off.reshape(-1), precision=jax.lax.Precision.HIGHEST)
