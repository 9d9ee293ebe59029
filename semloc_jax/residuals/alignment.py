"""The alignment residual: map contours seen by cameras, compared with the mask boundaries of their own class (room:
residuals; pure JAX).

In: a vehicle pose, camera views, one level of cost-map textures. Out: signed ramp values and weights.
r_i = ramp_c(i)(project(T_cam_base T_base_local p_i)), zero where contour i lies on a boundary of its class c(i).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.cameras import Camera, Rig
from semloc_jax.geometry import lie
from semloc_jax.residuals.texture import RampTexture, lookup
from semloc_jax.structs import ViewSamples


class CameraViews(eqx.Module):
    """Cameras of one model with what they see; every leaf has a leading camera axis."""

    camera: Camera
    T_cam_base: Float[Array, "cam 4 4"]
    p_map: Float[Array, "cam 3 p"]
    tangent_map: Float[Array, "cam 3 p"]
    """Direction of the contour; zero where nobody asks for it."""
    channel: Int[Array, "cam p"]
    weight: Float[Array, "cam p"]
    edge: Int[Array, "cam p"]
    """Number of the straight edge that each sample lies on; see `ViewSamples`."""
    index: Int[Array, " cam"]
    """Place of each camera in the rig and in the cost maps."""


def camera_views(rig: Rig, samples: ViewSamples) -> tuple[CameraViews, ...]:
    """The view of every camera, grouped by camera model."""
    dtype = samples.p_map.dtype
    views = []
    for group in rig.groups():
        index = jnp.asarray(group.index)
        views.append(
            CameraViews(
                camera=group.camera.astype(dtype),
                T_cam_base=lie.inverse(jnp.asarray(group.T_base_cam, dtype)),
                p_map=samples.p_map[index],
                tangent_map=samples.tangent_map[index],
                channel=samples.channel[index],
                weight=samples.weight[index],
                edge=samples.edge[index],
                index=index,
            )
        )
    return tuple(views)


def points_in_camera(
    T_cam_base: Float[Array, "4 4"], T_local_base: Float[Array, "4 4"], p_map: Float[Array, "3 p"]
) -> tuple[Array, Array, Array]:
    """Coordinates x, y, z in the camera frame [m] of points in the map frame."""
    T = lie.compose(T_cam_base, lie.inverse(T_local_base))
    x, y, z = p_map
    return tuple(T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3] for k in range(3))


def alignment_residual(
    T_local_base: Float[Array, "4 4"], views: tuple[CameraViews, ...], texture: RampTexture
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Signed ramp value in [-1, 1] and weight of every sample of every camera; the one definition of the residual.

    Args:
        T_local_base: Vehicle pose relative to the local origin.
        views: Views of all cameras of the rig.
        texture: One level of the cost maps.
    """

    def one_camera(view: CameraViews) -> tuple[Array, Array]:
        x, y, z = points_in_camera(view.T_cam_base, T_local_base, view.p_map)
        u, v, _ = view.camera.project_xyz(x, y, z)
        return lookup(texture, texture.image_index(view.index, view.channel), u, v), view.weight

    parts = [jax.vmap(one_camera)(view) for view in views]
    return tuple(jnp.concatenate([part[k].reshape(-1) for part in parts]) for k in range(2))


class Usable(eqx.Module):
    """Which pixels may be used, at a stride."""

    mask: Bool[Array, "cam h w"]
    stride: int = eqx.field(static=True)


def visibility(
    T_local_base: Float[Array, "4 4"], view: CameraViews, usable: Usable, margin_px: float
) -> Bool[Array, "cam p"]:
    """Whether each sample projects into the image, in front of the camera and on a usable pixel."""

    def one_camera(view: CameraViews) -> Array:
        u, v, valid = view.camera.project_xyz(*points_in_camera(view.T_cam_base, T_local_base, view.p_map))
        inside = valid & view.camera.in_image(u, v, margin_px)
        _, height, width = usable.mask.shape
        column = jnp.clip(jnp.nan_to_num(u / usable.stride), 0, width - 1).astype(jnp.int32)
        row = jnp.clip(jnp.nan_to_num(v / usable.stride), 0, height - 1).astype(jnp.int32)
        flat = (view.index * height + row) * width + column
        return inside & usable.mask.reshape(-1).at[flat].get(mode="promise_in_bounds")

    return jax.vmap(one_camera)(view)
