"""The robust cost of a pose, without derivatives (room: residuals; pure JAX).

In: pose, views, one level of textures, usable pixels. Out: summed robust cost and visible weight.
One evaluation of this costs a quarter of the normal equations: it ranks thousands of hypotheses.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from semloc_jax.residuals.alignment import CameraViews, Usable, points_in_camera, visibility
from semloc_jax.residuals.fusion_barrier import stored
from semloc_jax.residuals.robust import Kernel
from semloc_jax.residuals.texture import RampTexture, blend, fetch, locate


class RobustCost(NamedTuple):
    """How well a pose explains the masks."""

    summed: Float[Array, ""]
    """sum_i w_i rho(r_i) / rho(1) over visible samples."""
    visible: Float[Array, ""]
    """sum_i w_i over visible samples [px of contour]."""


def robust_cost(
    T_map_base: Float[Array, "4 4"],
    views: tuple[CameraViews, ...],
    texture: RampTexture,
    usable: Usable,
    kernel: Kernel,
    border_px: float,
    always: Bool[Array, "2"],
) -> RobustCost:
    """Summed robust cost and visible weight of a pose on one level of the cost maps."""

    def one_camera(view: CameraViews, weight: Array) -> tuple[Array, Array]:
        x, y, z = points_in_camera(view.T_cam_base, T_map_base, view.p_map)
        (uv,) = stored(always[0], jax.lax.complex(*view.camera.project_xyz(x, y, z)[:2]))
        texel = locate(texture, uv.real, uv.imag)
        (taps,) = stored(always[1], fetch(texture, texture.image_index(view.index, view.channel), texel))
        value, _, _ = blend(texture, taps, texel)
        ones = jnp.ones_like(weight)
        summed = jnp.dot(weight * kernel.rho(value), ones, precision=jax.lax.Precision.HIGHEST)
        return summed / kernel.worst, jnp.dot(weight, ones, precision=jax.lax.Precision.HIGHEST)

    summed, visible = jnp.zeros((), T_map_base.dtype), jnp.zeros((), T_map_base.dtype)
    for view in views:
        weight = view.weight * visibility(T_map_base, view, usable, border_px)
        sums = jax.vmap(one_camera)(view, weight)
        summed, visible = summed + jnp.sum(sums[0]), visible + jnp.sum(sums[1])
    return RobustCost(summed, visible)


def decimated(views: tuple[CameraViews, ...], keep_every: int) -> tuple[CameraViews, ...]:
    """Views with every k-th sample only, weighted k times: enough to tell hypotheses apart on a coarse level."""

    def thin(view: CameraViews) -> CameraViews:
        return eqx.tree_at(
            lambda v: (v.p_map, v.channel, v.weight),
            view,
            (view.p_map[..., ::keep_every], view.channel[:, ::keep_every], view.weight[:, ::keep_every] * keep_every),
        )

    return views if keep_every == 1 else tuple(thin(view) for view in views)
