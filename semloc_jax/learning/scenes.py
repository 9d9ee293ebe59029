"""Frames of drives with truth, ready to be solved and judged (room: learning; host).

In: a Drive with truth, its map and masks. Out: TrainingFrames of fixed shapes.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.pose import Prior
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.datasets import Drive, Frame
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.localized import localized_frames
from semloc_jax.learning.parameters import Parameters
from semloc_jax.maps import SemanticMap
from semloc_jax.perception.cost_maps import CostMapConfig, cost_maps
from semloc_jax.residuals.alignment import Usable, camera_views
from semloc_jax.residuals.smooth import SmoothBorder, SmoothScene, distance_maps
from semloc_jax.residuals.view import view


class TrainingFrame(eqx.Module):
    """What one frame shows, what was assumed, and where the vehicle was."""

    scene: SmoothScene
    """With the default model; `Parameters.model` gives another."""
    place: Int[Array, " channel"]
    """Place of each channel of the scene in the class table."""
    prior: Prior
    T_start: Float[Array, "4 4"]
    """What the search found; which optimum is meant."""
    T_true: Float[Array, "4 4"]
    """True pose relative to the local origin."""


def training_frames(
    drive: Drive, semantic_map: SemanticMap, masks: MaskSource, config: LearningConfig, seed: int = 0
) -> list[TrainingFrame]:
    """Frames spread evenly over a drive; `seed` draws the errors of their priors.

    Raises:
        SemlocError: the drive has no truth.
    """
    localizer = FrameLocalizer(semantic_map, masks.table, config.scene)
    return [
        training_frame(found.result.frame, found.prior, found.T_true, found.result.T_map_base, localizer, masks, config)
        for found in localized_frames(drive, localizer, masks, config, seed)
    ]


_view = jax.jit(view, static_argnames="config")


def training_frame(
    frame: Frame,
    prior: PosePrior,
    T_true: Float[np.ndarray, "4 4"],
    T_near: Float[np.ndarray, "4 4"],
    localizer: FrameLocalizer,
    masks: MaskSource,
    config: LearningConfig,
) -> TrainingFrame:
    """One frame with the map as it is seen from near the pose.

    Args:
        frame: The frame.
        prior: What is known of its pose beforehand.
        T_true: Its true T_map_base.
        T_near: Where solves start: what a search found, or the truth where the optimum is not at issue.
        localizer: Of the map, with the configuration to start from.
        masks: Of the drive.
        config: Ramp and stride that are stored.
    """
    dtype = jnp.zeros(()).dtype

    def cast(leaf: Array) -> Array:
        return leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    rig, seen_masks = masks.seen_by(frame.rig.select(masks.cameras)), masks.masks(frame)
    T_prior = prior.on_road(localizer.map)
    inputs, local_map = localizer.prepare(seen_masks, rig, T_prior)

    def local(T: np.ndarray) -> np.ndarray:
        return local_map.frame.from_map(T, np.float64)

    single, T_start = localizer.config.frame, local(T_near)
    near = jnp.asarray(T_start, jnp.float32)
    seen = _view(inputs.samples, near, rig, localizer.channel_of_label, single.polish_view)
    stored = CostMapConfig((config.stored_ramp_px,), (config.stored_stride,))
    maps = cost_maps(seen_masks, localizer.shown, stored)
    names = [channel.name for channel in localizer.shown.channels]
    place = jnp.asarray([masks.table.channel_index(name) for name in names], jnp.int32)
    model, nats_per_px = Parameters.defaults(len(masks.table.channels)).model(place, config)
    scene = SmoothScene(
        jax.tree.map(cast, camera_views(rig, seen)),
        jax.tree.map(cast, distance_maps(maps)),
        Usable(jnp.asarray(maps.usable), maps.usable_stride),
        model,
        nats_per_px,
        SmoothBorder(single.polish_align.border_px),
    )
    spread = localizer.map.road_spread(T_prior)
    known = jax.tree.map(cast, prior.to_solver(T_prior, local_map.frame, localizer.config.road, spread))
    return TrainingFrame(scene, place, known, jnp.asarray(T_start, dtype), jnp.asarray(local(T_true), dtype))
