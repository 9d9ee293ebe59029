"""Signs, lamp posts and lane markings of a map against the shapes that a mask shows (room: residuals; pure JAX).

In: vehicle pose, a shape in the map, the same shape in the image. Out: whitened offsets.
- corners of a triangle (3) or rectangle (4) and their pixels; the association settles which is which (the cyclic
  order);
- centre and radius of a round sign, and the ellipse that was seen;
- two points of the axis of a lamp post across the line that was seen (systems of the literature: both ends); along it
  only ends that were really seen count;
- points on the middle of a lane marking across the curve near each of them. MLVHM (2020) takes u - c(v), the difference
  to the curve in the row of the point; this is the same across the curve, to second order, so that it holds for curves
  of any direction and for every camera model.
"""

from typing import NamedTuple

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
