"""How far a pose moves contours across themselves in the image (room: residuals; pure JAX).

In: pose, cameras, contour points and their directions. Out: derivatives by the right tangent of the pose, and the
information that the map itself gives. The slopes of real masks also rise and fall along a contour, from pixel to pixel:
summed up they promise to hold a pose along a line, where nothing does.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.cameras import Camera
from semloc_jax.geometry import lie
from semloc_jax.residuals.alignment import CameraViews, points_in_camera

_HIGHEST = jax.lax.Precision.HIGHEST


def contour_information(
    T_local_base: Float[Array, "4 4"], views: tuple[CameraViews, ...], held: Float[Array, " n"]
) -> Float[Array, "6 6"]:
    """Information of a pose from displacements across the contours in view, in its right tangent.

    Args:
        T_local_base: Pose relative to the local origin.
        views: What the cameras see, with weights.
        held: Information of each sample [1/px^2], in the order of `alignment_residual`.
    """

    def rows(view: CameraViews) -> Array:
        return contour_rows(T_local_base, view.T_cam_base, view.camera, view.p_map, view.tangent_map)[0].T

    a = jnp.concatenate([jax.vmap(rows)(view).reshape(-1, 6) for view in views])
    a = jnp.where(jnp.isfinite(a) & (held > 0.0)[:, None], a, 0.0)
    return jnp.einsum("pi,p,pj->ij", a, held, a, precision=_HIGHEST)


def contour_rows(
    T_local_base: Float[Array, "4 4"],
    T_cam_base: Float[Array, "4 4"],
    camera: Camera,
    p_map: Float[Array, "3 p"],
    tangent_map: Float[Array, "3 p"],
) -> tuple[Float[Array, "6 p"], Float[Array, "2 p"], Float[Array, "2 p"]]:
    """How far the pose moves each point across its contour in the image, and where that is.

    Args:
        T_local_base: Vehicle pose.
        T_cam_base: Camera in the vehicle.
        camera: Its model.
        p_map: Contour points [m].
        tangent_map: Directions of the contour.

    Returns:
        Derivative of the distance across the contour by the right tangent [px/m, px/rad]; pixels; unit normals.
    """
    p_cam = points_in_camera(T_cam_base, T_local_base, p_map)
    R_cam_map = (T_cam_base @ lie.inverse(T_local_base))[:3, :3]
    along = R_cam_map @ tangent_map

    def pixel(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        return camera.project_xyz(x, y, z)[:2]

    (u, v), (du, dv) = jax.jvp(pixel, p_cam, tuple(along))
    length = jnp.sqrt(du * du + dv * dv + 1e-12)
    normal = jnp.stack([-dv, du]) / length
    return image_rows(T_local_base, T_cam_base, camera, p_map, normal), jnp.stack([u, v]), normal


def image_rows(
    T_local_base: Float[Array, "4 4"],
    T_cam_base: Float[Array, "4 4"],
    camera: Camera,
    p_map: Float[Array, "3 p"],
    direction: Float[Array, "2 p"],
) -> Float[Array, "6 p"]:
    """Derivative of each point's place along a direction of the image by the right tangent [px/m, px/rad]."""
    p_cam = points_in_camera(T_cam_base, T_local_base, p_map)
    across = jax.vjp(lambda *p: camera.project_xyz(*p)[:2], *p_cam)[1](tuple(direction))
    g = T_cam_base[:3, :3].T @ jnp.stack(across)
    p_base = jnp.stack(points_in_camera(jnp.eye(4, dtype=p_map.dtype), T_local_base, p_map))
    # Moving the vehicle by (v, omega) moves the point in its frame by -v - omega x p.
    return jnp.concatenate([-g, jnp.cross(g, p_base, axis=0)])
