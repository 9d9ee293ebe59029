"""What a pose costs, without derivatives (room: residuals; pure JAX).

In: pose, views, one level of textures, usable pixels. Out: summed robust cost and visible weight; ramp values.
One evaluation of this costs a quarter of the normal equations: it ranks thousands of hypotheses.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from semloc_jax.residuals import native_kernels
from semloc_jax.residuals.alignment import CameraViews, Usable, alignment_residual, points_in_camera, visibility
from semloc_jax.residuals.fusion_barrier import Walls, stored
from semloc_jax.residuals.robust import LOSSES, RobustLoss
from semloc_jax.residuals.texture import RampTexture, blend, fetch, locate


class RobustCost(NamedTuple):
    """How well a pose explains the masks."""

    summed: Float[Array, ""]
    """sum_i w_i rho(r_i) / rho(1) over visible samples."""
    visible: Float[Array, ""]
    """sum_i w_i over visible samples [px of contour]."""


def robust_cost(
    T_local_base: Float[Array, "4 4"],
    views: tuple[CameraViews, ...],
    texture: RampTexture,
    usable: Usable,
    loss: RobustLoss,
    border_px: float,
    path: native_kernels.Path = "auto",
) -> RobustCost:
    """Summed robust cost and visible weight of a pose on one level of the cost maps; `path` as `normal_equations`."""
    summed, visible = jnp.zeros((), T_local_base.dtype), jnp.zeros((), T_local_base.dtype)
    for view in views:
        view = eqx.tree_at(lambda v: v.weight, view, visible_weight(T_local_base, view, usable, border_px, path))
        summed = summed + jnp.sum(_summed(T_local_base, view, texture, loss, path))
        ones = jnp.ones_like(view.weight[0])
        visible = visible + jnp.sum(jnp.dot(view.weight, ones, precision=jax.lax.Precision.HIGHEST))
    return RobustCost(summed, visible)


def visible_weight(
    T_local_base: Float[Array, "4 4"],
    view: CameraViews,
    usable: Usable,
    border_px: float,
    path: native_kernels.Path = "auto",
) -> Float[Array, "cam p"]:
    """Weight of each sample where it can be seen from a pose, else 0."""
    if native_kernels.use(path, view.camera, LOSSES["tukey"], T_local_base.dtype) != "analytic":
        return view.weight * visibility(T_local_base, view, usable, border_px)

    def one_camera(view: CameraViews) -> Array:
        points = view.p_map, view.channel, view.weight
        camera, scale = (view.camera, view.T_cam_base), 1 / usable.stride
        return native_kernels.visible_weight(T_local_base, *camera, points, usable.mask, scale, view.index, border_px)

    return jax.vmap(one_camera)(view)


def ramp_values(
    T_local_base: Float[Array, "4 4"],
    views: tuple[CameraViews, ...],
    texture: RampTexture,
    path: native_kernels.Path = "auto",
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """`alignment_residual` where no derivative is wanted: by the kernels where they know the camera."""
    if any(native_kernels.use(path, v.camera, LOSSES["tukey"], T_local_base.dtype) != "analytic" for v in views):
        return alignment_residual(T_local_base, views, texture)

    def one_camera(view: CameraViews) -> Array:
        points = view.p_map, view.channel, view.weight
        return native_kernels.ramp_values(T_local_base, view.camera, view.T_cam_base, points, texture, view.index)

    values = [jax.vmap(one_camera)(view).reshape(-1) for view in views]
    return jnp.concatenate(values), jnp.concatenate([view.weight.reshape(-1) for view in views])


def sums_by_piece(
    T_local_base: Float[Array, "4 4"],
    views: tuple[CameraViews, ...],
    piece_of: Int[Array, " n"],
    texture: RampTexture,
    usable: Usable,
    loss: RobustLoss,
    border_px: float,
    path: native_kernels.Path = "auto",
) -> Float[Array, "2 n"]:
    """What a pose shows of each piece of contour: weight of its samples that can be seen, and the same times rho.

    Args:
        T_local_base: The pose.
        views: Of all cameras.
        piece_of: Piece of every sample, in the order of `alignment_residual`; those of a camera are numbered from that
            of its first sample on, at most one a sample.
        texture: One level of the cost maps.
        usable: Usable pixels.
        loss: Of the cost.
        border_px: Samples nearer to the border of the image are not used.
        path: As `normal_equations`.
    """
    if any(native_kernels.use(path, v.camera, loss, T_local_base.dtype) != "analytic" for v in views):
        seen = [visible_weight(T_local_base, v, usable, border_px, path) for v in views]
        views = tuple(eqx.tree_at(lambda v: v.weight, v, weight) for v, weight in zip(views, seen, strict=True))
        r, weight = ramp_values(T_local_base, views, texture, path)
        return sums_by_index(jnp.stack([weight, weight * loss.rho(r)]), piece_of, len(piece_of), path)

    def one_camera(view: CameraViews, piece: Int[Array, " p"]) -> Array:
        points, camera = (view.p_map, view.channel, view.weight), (view.camera, view.T_cam_base)
        seen = usable.mask, 1 / usable.stride, border_px
        return native_kernels.piece_sums(T_local_base, *camera, points, piece, *seen, texture, view.index)

    found, first = [], 0
    for view in views:
        num = view.weight.size
        own = piece_of[first : first + num].reshape(view.weight.shape)
        starts = first + view.weight.shape[1] * jnp.arange(len(own))
        found.append(jnp.moveaxis(jax.vmap(one_camera)(view, own - starts[:, None]), 1, 0).reshape(2, num))
        first += num
    return jnp.concatenate(found, axis=1)


def sums_by_index(
    values: Float[Array, "k n"], index: Int[Array, " n"], num: int, path: native_kernels.Path = "auto"
) -> Float[Array, "k num"]:
    """Sums of the values that share an index, for each of k rows; XLA on CPU takes a scatter one element at a time."""
    if native_kernels.are_used(path, values.dtype):
        return native_kernels.sums_by_index(values, index, num)
    return jax.vmap(lambda row: jax.ops.segment_sum(row, index, num))(values)


def _summed(
    T_local_base: Array, view: CameraViews, texture: RampTexture, loss: RobustLoss, path: native_kernels.Path
) -> Float[Array, " cam"]:
    """sum_i w_i rho(r_i) / rho(1) of each camera."""
    native = native_kernels.use(path, view.camera, loss, T_local_base.dtype) == "analytic"

    def one_camera(view: CameraViews) -> Array:
        if native:
            points = view.p_map, view.channel, view.weight
            return native_kernels.robust_cost(T_local_base, view.camera, view.T_cam_base, points, texture, view.index)
        x, y, z = points_in_camera(view.T_cam_base, T_local_base, view.p_map)
        walls = Walls.of(texture)
        (uv,) = stored(walls.odd, jax.lax.complex(*view.camera.project_xyz(x, y, z)[:2]))
        texel = locate(texture, uv.real, uv.imag)
        (taps,) = stored(walls.even, fetch(texture, texture.image_index(view.index, view.channel), texel))
        value, _, _ = blend(texture, taps, texel)
        ones = jnp.ones_like(view.weight)
        return jnp.dot(view.weight * loss.rho(value), ones, precision=jax.lax.Precision.HIGHEST) / loss.worst

    return jax.vmap(one_camera)(view)


def decimated(views: tuple[CameraViews, ...], keep_every: int) -> tuple[CameraViews, ...]:
    """Views with every k-th sample only, weighted k times: enough to tell hypotheses apart on a coarse level."""

    def thin(view: CameraViews) -> CameraViews:
        return eqx.tree_at(
            lambda v: (v.p_map, v.tangent_map, v.channel, v.edge, v.weight),
            view,
            (
                view.p_map[..., ::keep_every],
                view.tangent_map[..., ::keep_every],
                view.channel[:, ::keep_every],
                view.edge[:, ::keep_every],
                view.weight[:, ::keep_every] * keep_every,
            ),
        )

    return views if keep_every == 1 else tuple(thin(view) for view in views)
