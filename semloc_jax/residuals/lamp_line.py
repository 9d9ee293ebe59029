"""The axis of a lamp post against the line that a mask shows (room: residuals; pure JAX).

In: vehicle pose, two points of the axis in the map, the line and its two ends. Out: whitened signed distances.
Two points stand across the line (systems of the literature: both ends); along it only ends that were really seen count.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.residuals.seen_point import PointSight, seen_beside


class LineSight(NamedTuple):
    """A line in an image with two ends."""

    ends: PointSight
    """Lower and upper end, a leading axis over them."""
    normal_uv: Float[Array, "2 2"]
    """Unit, across the line at each end."""


def lamp_residual(
    T_map_base: Float[Array, "4 4"],
    points_map: Float[Array, "2 3"],
    line: LineSight,
    sqrt_info: Float[Array, "4 4"],
) -> Float[Array, "4"]:
    """Whitened distances of two points of the axis: across the line at both ends, then along it [px / sigma].

    Args:
        T_map_base: Vehicle pose.
        points_map: Points of the axis that belong to the lower and the upper end of the line [m].
        line: As the mask shows it.
        sqrt_info: Root of the information of the four distances [1/px]; rows of 0 along ends that were not seen.
    """
    off, _ = jax.vmap(seen_beside, (None, 0, 0))(T_map_base, points_map, line.ends)
    n = line.normal_uv
    across = jnp.sum(n * off, axis=1)
    along = n[:, 0] * off[:, 1] - n[:, 1] * off[:, 0]
    return jnp.matmul(sqrt_info, jnp.concatenate([across, along]), precision=jax.lax.Precision.HIGHEST)
