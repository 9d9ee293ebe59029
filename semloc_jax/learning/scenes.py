"""Frames of drives with truth, ready to be solved and judged (room: learning; host).

In: a Sequence with truth, its map and masks. Out: TrainingFrames of fixed shapes.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from semloc_jax.datasets import Sequence
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.fast_solve import FastSolve, fast_solves, prior_sigma
from semloc_jax.learning.parameters import Parameters
from semloc_jax.localization import FrameLocalizer, MaskSource
from semloc_jax.maps import SemanticMap
from semloc_jax.perception import CostMapConfig, cost_maps
from semloc_jax.residuals.alignment import Usable, camera_views
from semloc_jax.residuals.smooth import SmoothBorder, SmoothScene, distance_maps
from semloc_jax.residuals.view import view
from semloc_jax.solvers.pose import Prior


class TrainingFrame(eqx.Module):
    """What one frame shows, what was assumed, and where the vehicle was."""

    scene: SmoothScene
    """With the default model; `Parameters.model` gives another."""
    place: Int[Array, " channel"]
    """Place of each channel of the scene in the class table."""
    prior: Prior
    T_start: Float[Array, "4 4"]
    """Where the fast solve ended; which optimum is meant."""
    T_true: Float[Array, "4 4"]
    """True pose relative to the local origin."""


def training_frames(
    drive: Sequence, semantic_map: SemanticMap, masks: MaskSource, config: LearningConfig, seed: int = 0
) -> list[TrainingFrame]:
    """Frames spread evenly over a drive; `seed` draws the errors of their priors.

    Raises:
        SemlocError: the drive has no truth.
    """
    localizer = FrameLocalizer(semantic_map, masks.table, config.localize)
    solves = fast_solves(drive, localizer, masks, config, seed)
    return [_training_frame(solve, localizer, masks, config) for solve in solves]


_view = jax.jit(view, static_argnames="config")


def _training_frame(
    solve: FastSolve, localizer: FrameLocalizer, masks: MaskSource, config: LearningConfig
) -> TrainingFrame:
    """The smooth scene of a frame as it is seen from where the fast solve ended."""
    frame, dtype = localizer.config.frame, jnp.zeros(()).dtype

    def cast(leaf: Array) -> Array:
        return leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    near = jnp.asarray(solve.T_found, jnp.float32)
    seen = _view(solve.inputs.samples, near, solve.rig, localizer.channel_of_label, frame.polish_view)
    stored = CostMapConfig((config.stored_ramp_px,), (config.stored_stride,))
    maps = cost_maps(masks.masks(solve.frame), localizer.shown, stored)
    names = [channel.name for channel in localizer.shown.channels]
    place = jnp.asarray([masks.table.channel_index(name) for name in names], jnp.int32)
    model, nats_per_px = Parameters.defaults(len(masks.table.channels)).model(place, config)
    scene = SmoothScene(
        jax.tree.map(cast, camera_views(solve.rig, seen)),
        jax.tree.map(cast, distance_maps(maps)),
        Usable(jnp.asarray(maps.usable), maps.usable_stride),
        model,
        nats_per_px,
        SmoothBorder(frame.polish_align.border_px),
    )
    prior = Prior(jnp.asarray(solve.T_prior, dtype), jnp.asarray(prior_sigma(config), dtype))
    return TrainingFrame(scene, place, prior, jnp.asarray(solve.T_found, dtype), jnp.asarray(solve.T_true, dtype))
