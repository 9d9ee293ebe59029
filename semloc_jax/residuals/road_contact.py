"""A vehicle stands on the road (room: residuals; pure JAX).

In: vehicle pose, plane of the road, stance. Out: whitened height, roll and pitch of the vehicle against the road.
The stance is what all frames share: a loaded car sits lower and nose up on every one of them.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.geometry import lie


def road_residual(
    T_map_base: Float[Array, "4 4"],
    stance: Float[Array, "3"],
    point_map: Float[Array, "3"],
    normal_map: Float[Array, "3"],
    sqrt_info: Float[Array, "3"],
) -> Float[Array, "3"]:
    """Whitened height [m], roll and pitch [rad] of the vehicle above the plane of the road, less the stance.

    Args:
        T_map_base: Pose of the vehicle; the origin of base is where it touches the road.
        stance: Height [m], roll and pitch [rad] that all frames share.
        point_map: A point of the plane.
        normal_map: Its unit normal, upwards.
        sqrt_info: 1 / standard deviation of each; 0 where the road is not known.
    """
    height = jnp.dot(normal_map, T_map_base[:3, 3] - point_map, precision=jax.lax.Precision.HIGHEST)
    up = jnp.matmul(T_map_base[:3, :3].T, normal_map, precision=jax.lax.Precision.HIGHEST)
    return (jnp.stack([height, up[1], -up[0]]) - stance) * sqrt_info


def road_linearised(
    T_map_base: Float[Array, "4 4"],
    stance: Float[Array, "3"],
    point_map: Float[Array, "3"],
    normal_map: Float[Array, "3"],
    sqrt_info: Float[Array, "3"],
) -> tuple[Float[Array, "3"], Float[Array, "3 6"], Float[Array, "3 3"]]:
    """`road_residual` and its derivatives by the right tangent of the pose and by the stance."""
    up = jnp.matmul(T_map_base[:3, :3].T, normal_map, precision=jax.lax.Precision.HIGHEST)
    turn = lie.skew(up)  # exp(-omega) up = up + up x omega
    zero = jnp.zeros(3, up.dtype)
    rows = [jnp.concatenate([up, zero]), jnp.concatenate([zero, turn[1]]), jnp.concatenate([zero, -turn[0]])]
    r = road_residual(T_map_base, stance, point_map, normal_map, sqrt_info)
    return r, sqrt_info[:, None] * jnp.stack(rows), -jnp.diag(sqrt_info)
