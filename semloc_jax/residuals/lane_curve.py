"""A lane marking against the curve that a mask shows of it (room: residuals; pure JAX).

In: vehicle pose, points on the middle of the marking, the curve near each of them. Out: whitened distances across it.
MLVHM (2020) takes u - c(v), the difference to the curve in the row of the point; this is the same across the curve,
to second order, so that it holds for curves of any direction and for every camera model.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.residuals.seen_point import PointSight, seen_beside

MOST_PLACES = 8
"""Places of one curve: a cubic knows no more."""


class CurveSight(NamedTuple):
    """A curve in an image at some of its places; a leading axis over them."""

    at: PointSight
    normal_uv: Float[Array, "k 2"]
    """Unit, across the curve."""
    bend: Float[Array, " k"]
    """Curvature towards the normal [1/px]."""


def lane_residual(
    T_map_base: Float[Array, "4 4"],
    points_map: Float[Array, "k 3"],
    curve: CurveSight,
    sqrt_info: Float[Array, "k k"],
) -> Float[Array, " k"]:
    """Whitened distances of points of the map from a curve [px / sigma]: none along it.

    Args:
        T_map_base: Vehicle pose.
        points_map: On the middle of the marking, one for each place of the curve [m].
        curve: As the mask shows it.
        sqrt_info: Root of their information across the curve, all together [1/px]: places of one curve err alike.
    """
    off, _ = jax.vmap(seen_beside, (None, 0, 0))(T_map_base, points_map, curve.at)
    n = curve.normal_uv
    along = n[:, 0] * off[:, 1] - n[:, 1] * off[:, 0]
    across = jnp.sum(n * off, axis=1) - 0.5 * curve.bend * along**2
    return jnp.matmul(sqrt_info, across, precision=jax.lax.Precision.HIGHEST)
