"""A point of a lane marking against the curve that a mask shows of it (room: residuals; pure JAX).

In: vehicle pose, a point on the middle of the marking, the curve where it was seen. Out: whitened distance across it.
MLVHM (2020) takes u - c(v), the difference to the curve in the row of the point; this is the same across the curve,
to second order, so that it holds for curves of any direction and for every camera model.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.residuals.seen_point import PointSight, seen_beside


class CurveSight(NamedTuple):
    """A curve in an image, near one of its points."""

    at: PointSight
    normal_uv: Float[Array, "2"]
    """Unit, across the curve."""
    bend: Float[Array, ""]
    """Curvature towards the normal [1/px]."""


def lane_residual(
    T_map_base: Float[Array, "4 4"], point_map: Float[Array, "3"], curve: CurveSight, sqrt_info: Float[Array, ""]
) -> Float[Array, "1"]:
    """Whitened distance of a point of the map from a curve [px / sigma]: none along it.

    Args:
        T_map_base: Vehicle pose.
        point_map: On the middle of the marking [m].
        curve: As the mask shows it.
        sqrt_info: 1 / standard deviation across the curve [1/px].
    """
    off, _ = seen_beside(T_map_base, point_map, curve.at)
    n = curve.normal_uv
    along = n[0] * off[1] - n[1] * off[0]
    return (sqrt_info * (jnp.dot(n, off) - 0.5 * curve.bend * along**2))[None]
