"""How a vehicle moves: along its wheels, as fast as they turn, or not at all (room: residuals; pure JAX).

In: pose T_map_base, velocity in the map, odometer scale. Out: whitened velocities of the base.
The origin of the base is the rear axle, where wheels that roll go straight ahead.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def rolling_residual(
    T_map_base: Float[Array, "4 4"], velocity_map: Float[Array, "3"], sqrt_info: Float[Array, "2"]
) -> Float[Array, "2"]:
    """Velocity of the rear axle to the left and up [m/s], each over its standard deviation."""
    return sqrt_info * _in_base(T_map_base, velocity_map)[1:]


def wheel_speed_residual(
    T_map_base: Float[Array, "4 4"],
    velocity_map: Float[Array, "3"],
    scale: Float[Array, "1"],
    speed_mps: Float[Array, ""],
    sqrt_info: Float[Array, "1"],
) -> Float[Array, "1"]:
    """Velocity ahead less what the wheels say times the scale of the odometer [m/s], over its standard deviation."""
    return sqrt_info * (_in_base(T_map_base, velocity_map)[:1] - scale * speed_mps)


def fading_residual(
    start: Float[Array, " d"], end: Float[Array, " d"], share: Float[Array, " d"], sqrt_info: Float[Array, " d"]
) -> Float[Array, " d"]:
    """Change of slow quantities of which a share is left, over the standard deviation of what comes in its place.

    All of a bias or a scale is left, and of the bend of a road the less the longer the way.
    """
    return sqrt_info * (end - share * start)


def fading_linearised(
    start: Float[Array, " d"], end: Float[Array, " d"], share: Float[Array, " d"], sqrt_info: Float[Array, " d"]
) -> tuple[Float[Array, " d"], Float[Array, "d d"], Float[Array, "d d"]]:
    """`fading_residual` and its derivatives by start and end."""
    return fading_residual(start, end, share, sqrt_info), jnp.diag(-sqrt_info * share), jnp.diag(sqrt_info)


def standing_residual(velocity_map: Float[Array, "3"], sqrt_info: Float[Array, "3"]) -> Float[Array, "3"]:
    """Velocity of a vehicle that stands [m/s], over its standard deviation."""
    return sqrt_info * velocity_map


def _in_base(T_map_base: Array, velocity_map: Array) -> Float[Array, "3"]:
    return jnp.matmul(T_map_base[:3, :3].T, velocity_map, precision=jax.lax.Precision.HIGHEST)
