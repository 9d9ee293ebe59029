"""One point seen from two times, by its direction and inverse depth in the first (room: residuals; pure JAX).

In: poses T_map_base of the anchor and of a later time, the landmark, the line of sight. Out: whitened pixels.
Homogeneous: points at infinity (inverse depth 0) are as good as near ones. Pixels are taken in the tangent plane of the
measured ray, which holds for every camera model.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.geometry import lie

_LEAST_COSINE = 0.1
"""Of the angle between measured and predicted ray: beyond it (84 deg) the residual grows no faster."""


class Sight(NamedTuple):
    """One observation of a landmark."""

    anchor_axes: Float[Array, "3 3"]
    """R_cam_axes at the anchor: z is the first line of sight, on which direction (0, 0) lies."""
    T_base_cam_anchor: Float[Array, "4 4"]
    T_base_cam: Float[Array, "4 4"]
    """Of the camera that sees it now."""
    ray_cam: Float[Array, "3"]
    """Measured, unit length."""
    pixels: Float[Array, "2 3"]
    """Direction beside the ray to pixels, see `perception.sight_lines`."""


def sight_residual(
    T_map_anchor: Float[Array, "4 4"],
    T_map_base: Float[Array, "4 4"],
    landmark: Float[Array, "3"],
    sight: Sight,
    sqrt_info: Float[Array, ""],
) -> Float[Array, "2"]:
    """Whitened distance of the landmark from its line of sight [px / sigma].

    Args:
        T_map_anchor: Pose of the base at the time that first saw it.
        T_map_base: Pose of the base now.
        landmark: Direction (a, b) in the axes of the anchor and inverse depth [1/m] along their z: the point is
            (a, b, 1) / inverse depth.
        sight: The observation.
        sqrt_info: 1 / standard deviation [1/px].
    """
    q, depth, _, _ = _direction(T_map_anchor, T_map_base, landmark, sight)
    return sqrt_info * _mul(sight.pixels, q) / depth


def sight_linearised(
    T_map_anchor: Float[Array, "4 4"],
    T_map_base: Float[Array, "4 4"],
    landmark: Float[Array, "3"],
    sight: Sight,
    sqrt_info: Float[Array, ""],
) -> tuple[Float[Array, "2"], Float[Array, "2 6"], Float[Array, "2 6"], Float[Array, "2 3"]]:
    """The residual and its derivatives by the right tangents of both poses and by the landmark."""
    q, depth, X, Y = _direction(T_map_anchor, T_map_base, landmark, sight)
    rho = landmark[2]
    r = _mul(sight.pixels, q) / depth
    is_near = jnp.dot(sight.ray_cam, q) >= _LEAST_COSINE * jnp.linalg.norm(q)
    by_depth = jnp.where(is_near, sight.ray_cam, _LEAST_COSINE * q / jnp.linalg.norm(q))
    by_q = (sight.pixels - r[:, None] * by_depth) / depth
    R_cam_base, R_base_anchor = sight.T_base_cam[:3, :3].T, _mul(T_map_base[:3, :3].T, T_map_anchor[:3, :3])
    by_base = _mul(by_q, R_cam_base)
    by_anchor = _mul(by_base, R_base_anchor)
    moved = T_map_anchor[:3, 3] - T_map_base[:3, 3] + _mul(T_map_anchor[:3, :3], sight.T_base_cam_anchor[:3, 3])
    origin = _mul(T_map_base[:3, :3].T, moved) - sight.T_base_cam[:3, 3]
    axes = _mul(sight.T_base_cam_anchor[:3, :3], sight.anchor_axes)
    J_anchor = jnp.concatenate([rho * by_anchor, -_mul(by_anchor, lie.skew(X))], axis=1)
    J_base = jnp.concatenate([-rho * by_base, _mul(by_base, lie.skew(Y))], axis=1)
    J_landmark = jnp.concatenate([_mul(by_anchor, axes[:, :2]), _mul(by_base, origin)[:, None]], axis=1)
    return sqrt_info * r, sqrt_info * J_anchor, sqrt_info * J_base, sqrt_info * J_landmark


def on_road_residual(
    height_m: Float[Array, "1"],
    bend_per_m: Float[Array, "1"],
    landmark: Float[Array, "3"],
    up: Float[Array, "3"],
    lift_m: Float[Array, ""],
    away_m: Float[Array, ""],
    sqrt_info: Float[Array, "1"],
) -> Float[Array, "1"]:
    """Whitened height over the road of a landmark that lies on it, times its inverse depth: metric size for a camera.

    Args:
        height_m: Height of the base over the plane of the road.
        bend_per_m: How the road bends upwards, one over its radius.
        landmark: See `sight_residual`.
        up: The vertical axis of the base at the anchor, in the axes of the anchor.
        lift_m: Height of the camera in the base.
        away_m: Distance of the landmark over ground.
        sqrt_info: Depth along the line of sight over the standard deviation of the height of the road; 0: not on it.
    """
    ray = jnp.concatenate([landmark[:2], jnp.ones(1, landmark.dtype)])
    return sqrt_info * (jnp.sum(up * ray) + landmark[2] * (lift_m + height_m - 0.5 * away_m**2 * bend_per_m))


def on_road_linearised(
    height_m: Float[Array, "1"],
    bend_per_m: Float[Array, "1"],
    landmark: Float[Array, "3"],
    up: Float[Array, "3"],
    lift_m: Float[Array, ""],
    away_m: Float[Array, ""],
    sqrt_info: Float[Array, "1"],
) -> tuple[Float[Array, "1"], Float[Array, "1 1"], Float[Array, "1 1"], Float[Array, "1 3"]]:
    """`on_road_residual` and its derivatives by the height, the bend and the landmark."""
    fall = 0.5 * away_m**2
    by_landmark = jnp.concatenate([up[:2], lift_m + height_m - fall * bend_per_m])
    r = on_road_residual(height_m, bend_per_m, landmark, up, lift_m, away_m, sqrt_info)
    by_height = sqrt_info[:, None] * landmark[2]
    return r, by_height, -fall * by_height, sqrt_info[:, None] * by_landmark


def _direction(
    T_map_anchor: Array, T_map_base: Array, landmark: Array, sight: Sight
) -> tuple[Float[Array, "3"], Float[Array, ""], Float[Array, "3"], Float[Array, "3"]]:
    """Direction to the landmark in the camera, its part along the ray, and the landmark in the base, then and now.

    All are scaled by the inverse depth.
    """
    ray = _mul(sight.anchor_axes, jnp.concatenate([landmark[:2], jnp.ones(1, landmark.dtype)]))
    rho, T_then, T_now = landmark[2], sight.T_base_cam_anchor, sight.T_base_cam
    X = _mul(T_then[:3, :3], ray) + rho * T_then[:3, 3]
    offset = T_map_anchor[:3, 3] - T_map_base[:3, 3]
    Y = _mul(T_map_base[:3, :3].T, _mul(T_map_anchor[:3, :3], X) + rho * offset)
    q = _mul(T_now[:3, :3].T, Y - rho * T_now[:3, 3])
    depth = jnp.maximum(jnp.dot(sight.ray_cam, q), _LEAST_COSINE * jnp.linalg.norm(q))
    return q, depth, X, Y


def _mul(A: Array, b: Array) -> Array:
    """Product of small matrices as sums: one fused loop over many of them, where a product takes each alone."""
    return jnp.sum(A * b, axis=1) if b.ndim == 1 else jnp.sum(A[:, :, None] * b, axis=1)
