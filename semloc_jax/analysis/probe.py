"""Everything about one pose of a frame: what is seen from it, how well it fits, where a solve goes from it (room:
localization; JAX).

In: a pose, FrameInput, Prior. Out: the samples in the images with their residuals, PoseProbe, Descent.
Compiled once for all poses, levels and choices of classes: the explorer asks for dozens of them a second.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.level_choice import finest_held
from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, assess, level_problem, visible_views
from semloc_jax.alignment.problem import quadratic_model
from semloc_jax.alignment.single_frame import FrameInput, SingleFrameConfig
from semloc_jax.alignment.trace import LevelPath, trace_level
from semloc_jax.geometry import lie
from semloc_jax.residuals.alignment import CameraViews, alignment_residual, camera_views, points_in_camera
from semloc_jax.residuals.noise import is_inlier
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.view import ViewConfig, view
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import PoseEstimate, SolveStatus, ViewSamples


class ImageSamples(eqx.Module):
    """The samples of the map in the images of all cameras, in the order of the rig."""

    uv: Float[Array, "cam p 2"]
    """Pixels of the masks."""
    slope: Float[Array, "cam p 2"]
    """Unit direction of the contour in the image."""
    residual: Float[Array, "cam p"]
    """Signed distance to the mask boundary as a share of the ramp, in [-1, 1]; negative inside of the mask."""
    weight: Float[Array, "cam p"]
    """Length of contour that the sample stands for [px]; 0 where it is hidden or outside of the image."""
    in_view: Float[Array, "cam p"]
    """The same, hidden or not; 0 for padding and for classes that are switched off."""
    channel: Int[Array, "cam p"]


class ChannelFit(eqx.Module):
    """How well each mask channel fits, alone."""

    in_view_px: Float[Array, " channel"]
    """Weighted length of contour in view [px]."""
    visible_px: Float[Array, " channel"]
    """That part of it which falls on usable pixels [px]."""
    cost: Float[Array, " channel"]
    """Mask-normalised robust cost in [0, 1]; 0 where nothing is visible."""
    inlier_ratio: Float[Array, " channel"]
    """Share of the visible part within the ramp."""
    rms_px: Float[Array, " channel"]
    """Root mean square distance to the boundary of what is within the ramp [px]."""


class PoseProbe(eqx.Module):
    """What is known about one pose on one level of the cost maps."""

    samples: ImageSamples
    channels: ChannelFit
    estimate: PoseEstimate
    gradient: Float[Array, "6"]
    """Of the cost by the right tangent [nats / m, nats / rad]."""
    hessian: Float[Array, "6 6"]
    """Gauss-Newton Hessian likewise; with the gradient the quadratic model that the solver steps by."""
    xi_truth: Float[Array, "6"]
    """Right tangent from the pose to the true one [m, rad]."""


class Leg(NamedTuple):
    """One level of a descent."""

    stage: str
    """`coarse`: the map as seen from the start; `fine`: as seen from where the coarse stage ended."""
    level: int
    path: LevelPath


class Descent(NamedTuple):
    """A solve from one pose: coarse to fine, then polished."""

    legs: tuple[Leg, ...]
    last: int
    """Index of the leg whose pose counts: that of the finest level that holds."""
    status: SolveStatus

    @property
    def estimate(self) -> PoseEstimate:
        """Where it ends."""
        return self.legs[self.last].path.estimate


@stored_program("config")
def seen_from(
    T_local_base: Float[Array, "4 4"],
    frame: FrameInput,
    shown: Float[Array | np.ndarray, " channel"],
    config: ViewConfig,
) -> tuple[tuple[CameraViews, ...], ViewSamples]:
    """The map as it is seen from a pose, for the solver and, with its tangents, to be drawn.

    Args:
        T_local_base: Pose relative to the local origin.
        frame: Map samples and cameras.
        shown: Factor on the weight of each mask channel: 0 switches it off.
        config: Which samples are kept.
    """
    samples = view(frame.samples, T_local_base, frame.rig, frame.channel_of_label, config)
    samples = eqx.tree_at(lambda s: s.weight, samples, samples.weight * shown[samples.channel])
    return camera_views(frame.rig, samples), samples


@stored_program("config")
def probe(
    T_local_base: Float[Array, "4 4"],
    level: Int[Array | np.ndarray, ""],
    evidence: Evidence,
    samples: ViewSamples,
    prior: Prior,
    T_local_truth: Float[Array, "4 4"],
    config: AlignConfig,
) -> PoseProbe:
    """Residuals, fit by class, covariance and quadratic model at a pose.

    Args:
        T_local_base: Pose relative to the local origin.
        level: Level of the cost maps.
        evidence: The views of `seen_from` with the textures of the frame.
        samples: The samples of `seen_from`.
        prior: Its sigmas also scale the covariance.
        T_local_truth: The true pose; any other one where it is not known.
        config: Robust loss, noise and limits.
    """
    views = visible_views(T_local_base, evidence, config.border_px, config.path)
    model = quadratic_model(
        jnp.zeros(6, T_local_base.dtype), level_problem(T_local_base, views, level, evidence, prior, config)
    )
    free = prior.sigma > 0
    per_sigma = jnp.where(free, 1 / jnp.where(free, prior.sigma, 1.0), 0.0)
    drawn = _in_images(T_local_base, level, evidence, views, samples)
    ramp_px = evidence.textures.ramp_px[level]
    return PoseProbe(
        drawn,
        _fit_of_channels(drawn, ramp_px, evidence.textures.num_channels, config),
        assess(T_local_base, level, evidence, prior, config),
        model.gradient * per_sigma,
        model.hessian * per_sigma[:, None] * per_sigma,
        lie.log(lie.inverse(T_local_base) @ T_local_truth),
    )


def _in_images(
    T_local_base: Array, level: Array, evidence: Evidence, views: tuple[CameraViews, ...], samples: ViewSamples
) -> ImageSamples:
    texture = evidence.textures.level(level)
    shape = samples.weight.shape
    dtype = T_local_base.dtype
    uv, slope = jnp.zeros((*shape, 2), dtype), jnp.zeros((*shape, 2), dtype)
    residual, weight = jnp.zeros(shape, dtype), jnp.zeros(shape, dtype)
    for group in views:
        places, directions = jax.vmap(lambda v, t: _projected(T_local_base, v, t))(
            group, samples.tangent_map[group.index]
        )
        r, _ = alignment_residual(T_local_base, (group,), texture)
        uv, slope = uv.at[group.index].set(places), slope.at[group.index].set(directions)
        residual = residual.at[group.index].set(r.reshape(group.weight.shape))
        weight = weight.at[group.index].set(group.weight)
    return ImageSamples(uv, slope, residual, weight, samples.weight, samples.channel)


def _projected(T_local_base: Array, group: CameraViews, tangent_map: Array) -> tuple[Array, Array]:
    """Pixels [p 2] of one camera's samples, and the unit direction of their contours there."""

    def pixel(p_map: Array) -> tuple[Array, Array]:
        return group.camera.project_xyz(*points_in_camera(group.T_cam_base, T_local_base, p_map))[:2]

    places, moved = jax.jvp(pixel, (group.p_map,), (tangent_map,))
    direction = jnp.stack(moved, axis=-1)
    return jnp.stack(places, axis=-1), direction / jnp.maximum(jnp.linalg.norm(direction, axis=-1, keepdims=True), 1e-6)


def _fit_of_channels(drawn: ImageSamples, ramp_px: Array, num_channels: int, config: AlignConfig) -> ChannelFit:
    loss = LOSSES[config.loss]
    r, weight = drawn.residual, drawn.weight
    within = weight * is_inlier(r)

    def summed(value: Array) -> Array:
        return jax.ops.segment_sum(value.reshape(-1), drawn.channel.reshape(-1), num_channels)

    visible, held = summed(weight), summed(within)
    per_visible = 1 / jnp.maximum(visible, 1e-6)
    return ChannelFit(
        summed(drawn.in_view),
        visible,
        summed(weight * loss.rho(r)) * per_visible / loss.worst,
        held * per_visible,
        ramp_px * jnp.sqrt(summed(within * r * r) / jnp.maximum(held, 1e-6)),
    )


def descend(
    T_start: Float[Array, "4 4"],
    frame: FrameInput,
    shown: Float[Array | np.ndarray, " channel"],
    prior: Prior,
    config: SingleFrameConfig,
) -> Descent:
    """The solve from one start with every step, on the host; `align` of the search and then that of the polish.

    Args:
        T_start: Start pose relative to the local origin.
        frame: Map samples, cost maps, cameras.
        shown: Factor on the weight of each mask channel.
        prior: Prior pose and its sigmas.
        config: Views and refinement of the search and of the polish.
    """
    T, legs = T_start, []
    most = max(config.search_align.max_steps, config.polish_align.max_steps)
    for stage, look, align in (
        ("coarse", config.search_view, config.search_align),
        ("fine", config.polish_view, config.polish_align),
    ):
        views, _ = seen_from(T, frame, shown, look)
        evidence = Evidence(views, frame.textures, frame.usable)
        # One program for both stages, where they differ in levels and steps only.
        settings = replace(align, levels=(), max_steps=most)
        for level in align.levels:
            path = trace_level(T, T_start, np.int32(level), np.int32(align.max_steps), evidence, prior, settings)
            T = path.estimate.T_local_base
            legs.append(Leg(stage, level, path))
    return _judged(jax.device_get(legs), config.polish_align)


def _judged(legs: list[Leg], polish: AlignConfig) -> Descent:
    """The descent with the leg that counts, as `align` picks it."""
    first = len(legs) - len(polish.levels)
    inlier_ratio = np.array([leg.path.estimate.inlier_ratio for leg in legs[first:]])
    last = first + int(finest_held(inlier_ratio, polish.min_inlier_ratio))
    status = SolveStatus(int(legs[last].path.estimate.status))
    if status == SolveStatus.CONVERGED and not legs[last].path.converged:
        status = SolveStatus.MAX_STEPS
    if not all(np.isfinite(leg.path.estimate.T_local_base).all() for leg in legs):
        status = SolveStatus.NOT_FINITE
    return Descent(tuple(legs), last, status)
