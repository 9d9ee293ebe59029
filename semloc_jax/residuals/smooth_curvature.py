"""Value, force and full curvature of the smooth alignment cost, written out (room: residuals; pure JAX).

In: a vehicle pose and a SmoothScene. Out: CostExpansion, derivatives by the twelve numbers of T_base_local.
A sample depends on the pose through its three coordinates in the camera, which are linear in T_base_local: everything
of second order is a 3x3 matrix for each sample. Automatic derivatives of `smooth_cost` are the same, at three times the
time and many times the compilation.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.residuals.alignment import CameraViews, points_in_camera
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.smooth import (
    SmoothScene,
    cubic_value,
    distance_patch,
    reach_and_gain,
    seen_share,
)

_HIGHEST = jax.lax.Precision.HIGHEST


class CostExpansion(NamedTuple):
    """The cost around a pose, to second order."""

    penalty: tuple[Float[Array, "cam p"], ...]
    """Nats of each sample for each independent observation that it stands for, by camera model."""
    weight: tuple[Float[Array, "cam p"], ...]
    """Independent observations, with visibility."""
    gradient: Float[Array, "3 4"]
    """By the numbers of T_base_local, weights held."""
    hessian: Float[Array, "3 4 3 4"]
    """The derivative of the gradient, weights following the pose."""


def cost_expansion(T_local_base: Float[Array, "4 4"], scene: SmoothScene) -> CostExpansion:
    """The cost of all cameras to second order around a pose."""
    parts = [jax.vmap(lambda view: _expansion(T_local_base, view, scene))(view) for view in scene.views]
    return CostExpansion(
        tuple(part.penalty for part in parts),
        tuple(part.weight for part in parts),
        sum(jnp.sum(part.gradient, axis=0) for part in parts),
        sum(jnp.sum(part.hessian, axis=0) for part in parts),
    )


class SampleExpansion(NamedTuple):
    """The cost of every sample of one camera to second order, by its coordinates x, y, z in the camera."""

    penalty: Float[Array, " p"]
    """Nats for each independent observation that the sample stands for."""
    weight: Float[Array, " p"]
    """Independent observations, with visibility."""
    gradient: Float[Array, "3 p"]
    """Weights held."""
    hessian: Float[Array, "3 3 p"]
    """Derivative of the gradient (first index), weights following the place of the sample."""
    information: Float[Array, "3 3 p"]
    """What is left of the curvature in Gauss-Newton's approximation, with the weight of the loss."""
    distance_px: Float[Array, " p"]
    """Signed distance to the boundary of its own channel."""
    pull: Float[Array, " p"]
    """Weight of the loss: 1 on the boundary, 0 where it has let go."""


def sample_expansion(T_local_base: Float[Array, "4 4"], view: CameraViews, scene: SmoothScene) -> SampleExpansion:
    """The cost of each sample of one camera to second order; `cost_expansion` is their sum."""
    p_cam = jnp.stack(points_in_camera(view.T_cam_base, T_local_base, view.p_map))
    (u, v, valid), slopes = _slopes(view, p_cam)
    patch = distance_patch(u, v, view, scene.maps)
    reach_px, gain = reach_and_gain(view.channel, scene.model)
    stride = scene.maps.stride
    ratio = cubic_value(patch) / reach_px
    first = [cubic_value(patch, *order) / (stride * reach_px) for order in ((1, 0), (0, 1))]
    second = [cubic_value(patch, *order) / (stride * stride * reach_px) for order in ((2, 0), (1, 1), (0, 2))]

    held = LOSSES["tukey"].weight(ratio)
    push, curve = gain * ratio * held, gain * _rho_curvature(ratio)
    by_uv = [push * first[0], push * first[1]]
    twice_uv = [curve * first[i] * first[j] + push * second[i + j] for i, j in ((0, 0), (0, 1), (1, 1))]
    by_p = [by_uv[0] * slopes[0][k] + by_uv[1] * slopes[1][k] for k in range(3)]
    rise = [first[0] * slopes[0][k] + first[1] * slopes[1][k] for k in range(3)]

    share, *fade = seen_share(u, v, view, scene.usable, scene.border)
    fade_by_p = [fade[0] * slopes[0][k] + fade[1] * slopes[1][k] for k in range(3)]
    full = jnp.where(valid, scene.nats_per_px * view.weight, 0.0)
    weight = full * share
    bent = _camera_curvature(view, p_cam, by_uv)

    def twice(i: int, j: int) -> Array:
        (ui, uj), (vi, vj) = ((slope[i], slope[j]) for slope in slopes)
        evidence = twice_uv[0] * ui * uj + twice_uv[1] * (ui * vj + vi * uj) + twice_uv[2] * vi * vj + bent[j][i]
        return weight * evidence + full * by_p[i] * fade_by_p[j]

    return SampleExpansion(
        gain * LOSSES["tukey"].rho(ratio),
        weight,
        weight * jnp.stack(by_p),
        jnp.stack([jnp.stack([twice(i, j) for j in range(3)]) for i in range(3)]),
        weight * gain * held * jnp.stack([jnp.stack([a * b for b in rise]) for a in rise]),
        reach_px * ratio,
        held,
    )


def _expansion(T_local_base: Array, view: CameraViews, scene: SmoothScene) -> CostExpansion:
    p_one = jnp.concatenate([view.p_map, jnp.ones_like(view.p_map[:1])])
    samples = sample_expansion(T_local_base, view, scene)
    gradient = jnp.einsum("ip,kp->ik", samples.gradient, p_one, precision=_HIGHEST)
    rows = (samples.hessian.reshape(9, 1, -1) * p_one[None]).reshape(36, -1)
    hessian = jnp.matmul(rows, p_one.T, precision=_HIGHEST).reshape(3, 3, 4, 4).transpose(0, 2, 1, 3)
    R = view.T_cam_base[:3, :3]
    gradient = jnp.einsum("ia,ik->ak", R, gradient, precision=_HIGHEST)
    hessian = jnp.einsum("ia,ikjl,jb->akbl", R, hessian, R, precision=_HIGHEST)
    return CostExpansion(samples.penalty, samples.weight, gradient, hessian)


def _slopes(view: CameraViews, p_cam: Array) -> tuple:
    """Pixels, and their derivatives by the coordinates in the camera: those of u, those of v."""
    x, y, z = p_cam
    (u, v, valid), push = jax.linearize(lambda *p: view.camera.project_xyz(*p), x, y, z)
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    by = [push(*(one if k == j else zero for k in range(3))) for j in range(3)]
    return (u, v, valid), ([slope[0] for slope in by], [slope[1] for slope in by])


def _camera_curvature(view: CameraViews, p_cam: Array, by_uv: list[Array]) -> list[tuple[Array, ...]]:
    """Second derivatives by the coordinates of the pixels, u and v summed with the weights `by_uv`."""

    def gradient(x: Array, y: Array, z: Array) -> tuple[Array, ...]:
        _, pull = jax.vjp(lambda *p: view.camera.project_xyz(*p)[:2], x, y, z)
        return pull(tuple(by_uv))

    x, y, z = p_cam
    _, push = jax.linearize(gradient, x, y, z)
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    return [push(*(one if k == j else zero for k in range(3))) for j in range(3)]


def _rho_curvature(v: Array) -> Array:
    t = jnp.maximum(1 - v * v, 0)
    return t * (t - 4 * v * v)
