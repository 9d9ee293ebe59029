"""Spots of the road that cameras see at several times, with unknown mounts (room: residuals; pure JAX).

In: mounts T_base_cam, poses T_odom_base, lines of sight. Out: whitened distances on the road, the plane z = 0 of odom.
Distances count in heights of the camera over the road, so that nothing is gained by a world that is smaller altogether.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.geometry import lie

LEAST_DIP = 0.02
"""A line of sight is taken to dip at least this much: one above the horizon meets the road nowhere."""
_LEAST_HEIGHT_M = 0.05


def road_spot(
    T_base_cam: Float[Array, "4 4"], T_odom_base: Float[Array, "4 4"], ray_cam: Float[Array, "3"]
) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Place (x, y) in odom [m] where a line of sight meets the road, and the height of its camera [m]."""
    T_odom_cam = lie.compose(T_odom_base, T_base_cam)
    ray = jnp.matmul(T_odom_cam[:3, :3], ray_cam, precision=jax.lax.Precision.HIGHEST)
    reach = T_odom_cam[2, 3] / jnp.maximum(-ray[2], LEAST_DIP)
    return T_odom_cam[:2, 3] + reach * ray[:2], jnp.maximum(T_odom_cam[2, 3], _LEAST_HEIGHT_M)


def on_line_residual(
    T_base_cam: Float[Array, "4 4"],
    T_odom_base: Float[Array, "4 4"],
    line: Float[Array, "2"],
    ray_cam: Float[Array, "3"],
    along: Float[Array, "2 2"],
    sqrt_info: Float[Array, ""],
) -> Float[Array, "1"]:
    """Distance of a seen spot from the middle of a painted line, over its standard deviation.

    Args:
        T_base_cam: Mount of the camera.
        T_odom_base: Pose of the vehicle.
        line: How far the line lies to the left of a fixed one [m], and its turn against it [rad].
        ray_cam: Line of sight, unit length.
        along: A point of the fixed line and its unit direction.
        sqrt_info: 1 / standard deviation, in heights of the camera.
    """
    spot, height_m = road_spot(T_base_cam, T_odom_base, ray_cam)
    offset = spot - along[0]
    normal = jnp.stack([-along[1, 1], along[1, 0]])
    ahead, left = jnp.dot(along[1], offset), jnp.dot(normal, offset)
    return (sqrt_info / height_m * (jnp.cos(line[1]) * left - jnp.sin(line[1]) * ahead - line[0]))[None]


def at_end_residual(
    T_base_cam: Float[Array, "4 4"],
    T_odom_base: Float[Array, "4 4"],
    end: Float[Array, "1"],
    ray_cam: Float[Array, "3"],
    along: Float[Array, "2 2"],
    sqrt_info: Float[Array, ""],
) -> Float[Array, "1"]:
    """How far beyond the end of a painted line a seen end lies, over its standard deviation.

    `end` is the place of the end along the fixed line `along`; the rest is as in `on_line_residual`.
    """
    spot, height_m = road_spot(T_base_cam, T_odom_base, ray_cam)
    return sqrt_info / height_m * (jnp.dot(along[1], spot - along[0]) - end)


def same_spot_residual(
    T_base_first: Float[Array, "4 4"],
    T_odom_first: Float[Array, "4 4"],
    T_base_second: Float[Array, "4 4"],
    T_odom_second: Float[Array, "4 4"],
    ray_first: Float[Array, "3"],
    ray_second: Float[Array, "3"],
    sqrt_info: Float[Array, "2 2"],
) -> Float[Array, "2"]:
    """Whitened difference on the road of one spot that is seen twice: by two cameras, or at two times, or both."""
    first, first_height_m = road_spot(T_base_first, T_odom_first, ray_first)
    second, second_height_m = road_spot(T_base_second, T_odom_second, ray_second)
    off = (first - second) / jnp.sqrt(first_height_m * second_height_m)
    return jnp.matmul(sqrt_info, off, precision=jax.lax.Precision.HIGHEST)
