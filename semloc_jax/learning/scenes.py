"""Frames of drives with truth, ready to be solved and judged (room: learning; host).

In: a Sequence with truth, its map and masks. Out: TrainingFrames of fixed shapes.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.datasets import Sequence
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.parameters import Parameters
from semloc_jax.localization import FrameLocalizer, MaskSource
from semloc_jax.localization.run import sample_within
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
    T_true: Float[Array, "4 4"]
    """True pose relative to the local origin."""


def training_frames(
    drive: Sequence, semantic_map: SemanticMap, masks: MaskSource, config: LearningConfig
) -> list[TrainingFrame]:
    """Frames spread evenly over a drive.

    Raises:
        SemlocError: the drive has no truth.
    """
    if drive.truth is None:
        raise SemlocError(f"drive {drive.name}: has no truth to learn from; expected poses_body.tum")
    localizer = FrameLocalizer(semantic_map, masks.table, config.localize)
    chosen = np.unique(np.linspace(0, len(drive) - 1, config.num_frames).astype(int))
    rng = np.random.default_rng(config.seed)
    return [_training_frame(drive, drive.frames[index], localizer, masks, rng, config) for index in chosen]


_view = jax.jit(view, static_argnames="config")


def prior_sigma(config: LearningConfig) -> np.ndarray:
    """Standard deviations (x, y, z [m], roll, pitch, yaw [rad]) of the prior of a frame."""
    road = config.localize.road
    tilt = np.deg2rad(road.roll_pitch_deg)
    return np.array([config.sigma_m, config.sigma_m, road.height_m, tilt, tilt, np.deg2rad(config.sigma_deg)])


def _training_frame(drive, frame, localizer: FrameLocalizer, masks: MaskSource, rng, config: LearningConfig):
    """One frame; what is known before it is off by a seeded error of its own size."""
    sigma, settings, shown = prior_sigma(config), localizer.config, localizer.shown
    T_true = drive.truth_at(frame)
    T_prior = T_true @ rigid.exp(sigma * rng.normal(size=6))
    rig = masks.seen_by(frame.rig.select(masks.cameras))
    heading = float(np.arctan2(T_true[1, 0], T_true[0, 0])) if len(rig) == 1 else None
    local_map = localizer.map.query(T_prior[:3, 3], settings.search_radius_m, heading)
    samples = sample_within(local_map, settings.sample_spacing_m, settings.sample_capacity)
    for T in (T_true, T_prior):
        T[:3, 3] -= local_map.origin_map
    seen = _view(
        samples, jnp.asarray(T_prior, jnp.float32), rig, localizer.channel_of_label, settings.frame.polish_view
    )
    maps = cost_maps(masks.masks(frame), shown, CostMapConfig((config.stored_ramp_px,), (config.stored_stride,)))
    dtype = jnp.zeros(()).dtype
    place = jnp.asarray([masks.table.channel_index(channel.name) for channel in shown.channels], jnp.int32)
    model, nats_per_px = Parameters.defaults(len(masks.table.channels)).model(place, config)
    scene = SmoothScene(
        jax.tree.map(lambda leaf: leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf,
                     camera_views(rig, seen)),
        jax.tree.map(lambda leaf: leaf.astype(dtype), distance_maps(maps)),
        Usable(jnp.asarray(maps.usable), maps.usable_stride),
        model,
        nats_per_px,
        SmoothBorder(settings.frame.polish_align.border_px),
    )  # fmt: skip
    prior = Prior(jnp.asarray(T_prior, dtype), jnp.asarray(sigma, dtype))
    return TrainingFrame(scene, place, prior, jnp.asarray(T_true, dtype))
