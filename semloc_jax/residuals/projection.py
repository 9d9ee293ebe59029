"""Where a camera sees points and contours, and how far they move in the image (room: residuals; pure JAX).

In: points in a camera frame; a pose, contour points and their directions. Out: Projected: pixels, validity, derivative
of the pixel by the point; contours across themselves: derivatives by the right tangent of the pose, and the information
that the map itself gives.
`Projected` has no derivatives of its own: it serves what is decided about samples before a pose is solved. The slopes
of real masks also rise and fall along a contour, from pixel to pixel: summed up they promise to hold a pose along a
line, where nothing does.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from semloc_jax.cameras import Camera
from semloc_jax.geometry import lie
from semloc_jax.residuals import native_kernels
from semloc_jax.residuals.alignment import CameraViews, points_in_camera
from semloc_jax.residuals.robust import LOSSES


class Projected(NamedTuple):
    """Points as one camera sees them."""

    u: Float[Array, " p"]
    v: Float[Array, " p"]
    valid: Bool[Array, " p"]
    """Whether the camera can see in that direction; the image is not looked at."""
    du: Float[Array, "3 p"]
    """Derivative of u by the point in the camera frame [px / m]."""
    dv: Float[Array, "3 p"]

    def moved_px(self, direction_cam: Float[Array, "*p 3"]) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
        """Pixels that each point moves in u and v for one metre along a direction of the camera frame."""
        x, y, z = direction_cam[..., 0], direction_cam[..., 1], direction_cam[..., 2]
        return tuple(slope[0] * x + slope[1] * y + slope[2] * z for slope in (self.du, self.dv))


def projected(camera: Camera, p_cam: Float[Array, "3 p"], path: native_kernels.Path = "auto") -> Projected:
    """Points as a camera sees them; `path` as for `residuals.normal_equations`.

    XLA computes the lens again for each of the numbers that use it, and compiles it as often; a kernel does it once.
    """
    if native_kernels.use(path, camera, LOSSES["tukey"], p_cam.dtype) == "analytic":
        rows = native_kernels.project(camera, p_cam)
        return Projected(rows[0], rows[1], rows[2] > 0, rows[3:6], rows[6:9])
    (u, v, valid), push = jax.linearize(camera.project_xyz, *p_cam)
    axes = [push(*(jnp.full_like(u, k == axis) for k in range(3)))[:2] for axis in range(3)]
    du, dv = (jnp.stack(column) for column in zip(*axes, strict=True))
    return Projected(u, v, valid, du, dv)


_HIGHEST = jax.lax.Precision.HIGHEST


def contour_information(
    T_map_base: Float[Array, "4 4"], views: tuple[CameraViews, ...], held: Float[Array, " n"]
) -> Float[Array, "6 6"]:
    """Information of a pose from displacements across the contours in view, in its right tangent.

    Args:
        T_map_base: Pose relative to the local origin.
        views: What the cameras see, with weights.
        held: Information of each sample [1/px^2], in the order of `alignment_residual`.
    """

    def rows(view: CameraViews) -> Array:
        return contour_rows(T_map_base, view.T_cam_base, view.camera, view.p_map, view.tangent_map)[0].T

    a = jnp.concatenate([jax.vmap(rows)(view).reshape(-1, 6) for view in views])
    a = jnp.where(jnp.isfinite(a) & (held > 0.0)[:, None], a, 0.0)
    return jnp.einsum("pi,p,pj->ij", a, held, a, precision=_HIGHEST)


def contour_rows(
    T_map_base: Float[Array, "4 4"],
    T_cam_base: Float[Array, "4 4"],
    camera: Camera,
    p_map: Float[Array, "3 p"],
    tangent_map: Float[Array, "3 p"],
) -> tuple[Float[Array, "6 p"], Float[Array, "2 p"], Float[Array, "2 p"]]:
    """How far the pose moves each point across its contour in the image, and where that is.

    Args:
        T_map_base: Vehicle pose.
        T_cam_base: Camera in the vehicle.
        camera: Its model.
        p_map: Contour points [m].
        tangent_map: Directions of the contour.

    Returns:
        Derivative of the distance across the contour by the right tangent [px/m, px/rad]; pixels; unit normals.
    """
    p_cam = points_in_camera(T_cam_base, T_map_base, p_map)
    R_cam_map = (T_cam_base @ lie.inverse(T_map_base))[:3, :3]
    along = R_cam_map @ tangent_map

    def pixel(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        return camera.project_xyz(x, y, z)[:2]

    (u, v), (du, dv) = jax.jvp(pixel, p_cam, tuple(along))
    length = jnp.sqrt(du * du + dv * dv + 1e-12)
    normal = jnp.stack([-dv, du]) / length
    return image_rows(T_map_base, T_cam_base, camera, p_map, normal), jnp.stack([u, v]), normal


def image_rows(
    T_map_base: Float[Array, "4 4"],
    T_cam_base: Float[Array, "4 4"],
    camera: Camera,
    p_map: Float[Array, "3 p"],
    direction: Float[Array, "2 p"],
) -> Float[Array, "6 p"]:
    """Derivative of each point's place along a direction of the image by the right tangent [px/m, px/rad]."""
    p_cam = points_in_camera(T_cam_base, T_map_base, p_map)
    across = jax.vjp(lambda *p: camera.project_xyz(*p)[:2], *p_cam)[1](tuple(direction))
    g = T_cam_base[:3, :3].T @ jnp.stack(across)
    p_base = jnp.stack(points_in_camera(jnp.eye(4, dtype=p_map.dtype), T_map_base, p_map))
    # Moving the vehicle by (v, omega) moves the point in its frame by -v - omega x p.
    return jnp.concatenate([-g, jnp.cross(g, p_base, axis=0)])
