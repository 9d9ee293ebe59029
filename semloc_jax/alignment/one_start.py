"""The pose from a single start that may be metres off: several looks at the map, each from where the last one ended
(room: alignment; JAX).

In: start pose, prior sigmas, one frame. Out: the pose after all looks.
Three things hold a single start back. A heading error of 5 deg is wider in the image than the usual ramps. While ramps
are wide, a pose may slide metres back along the road, unless the masks count less there and the prior more. And paint
near the car outweighs the poles and signs that tell lanes apart, unless classes are balanced.
"""

from dataclasses import dataclass, field, replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.alignment.pose import AlignConfig, Prior, refine
from semloc_jax.alignment.single_frame import FrameInput, evidence_from
from semloc_jax.perception import CostMapConfig
from semloc_jax.residuals.alignment import CameraViews
from semloc_jax.residuals.view import ViewConfig

WIDE_COST_MAPS = CostMapConfig(ramp_px=(160.0, 80.0, 40.0, 20.0, 14.0, 8.0, 3.0), stride=(8, 8, 4, 4, 2, 2, 1))
"""Levels for starts that are up to some metres and ten degrees off."""


@dataclass(frozen=True)
class LookConfig:
    """One look at the map from where the pose is, and a descent from there."""

    levels: tuple[int, ...]
    """Levels of the cost maps that are visited."""
    noise_share: float
    """Boundary noise as a share of the ramp: the larger, the more the prior holds the pose on coarse levels."""
    class_balance: float = 0.0
    """0: a class counts by its length in the image; 1: every class in view counts the same."""
    max_steps: int = 16
    """Most evaluations on each level."""


@dataclass(frozen=True)
class OneStartConfig:
    """How a pose is found from one start. All values are ours; levels are those of `WIDE_COST_MAPS`."""

    looks: tuple[LookConfig, ...] = (
        LookConfig((0, 1, 2, 3), noise_share=1.0, class_balance=1.0),
        LookConfig((0, 1, 2, 3), noise_share=0.5, class_balance=1.0),
        LookConfig((2, 3, 4, 5, 6), noise_share=0.15, class_balance=0.5),
    )
    view: ViewConfig = field(default_factory=lambda: ViewConfig(margin_share=0.3, metric_exponent=1.0))
    """How the map is seen: with a margin, since the truth looks elsewhere, and evenly by length in the world."""
    align: AlignConfig = field(default_factory=AlignConfig)
    """Loss, noise and limits; levels, steps and noise share are those of the looks."""


def from_one_start(
    T_start: Float[Array, "4 4"], sigma: Float[Array, "6"], frame: FrameInput, config: OneStartConfig
) -> Float[Array, "4 4"]:
    """Returns the pose T_local_base after all looks; pure JAX, to be mapped over starts.

    Args:
        T_start: Start, also the centre of the prior, relative to the local origin.
        sigma: Standard deviations of the prior (x, y, z [m], roll, pitch, yaw [rad]).
        frame: Map samples, cost maps, cameras.
        config: Looks and view.
    """
    T, prior = T_start, Prior(T_start, sigma)
    for look in config.looks:
        evidence = evidence_from(T, frame, config.view)
        balanced = balance_classes(evidence.views, evidence.textures.num_channels, look.class_balance)
        evidence = eqx.tree_at(lambda e: e.views, evidence, balanced)
        noise = replace(config.align.noise, ramp_share=look.noise_share)
        align = replace(config.align, levels=look.levels, max_steps=look.max_steps, noise=noise)
        T = refine(T, evidence, prior, align)[0][-1]
    return T


def balance_classes(views: tuple[CameraViews, ...], num_channels: int, share: float) -> tuple[CameraViews, ...]:
    """The views with the weights of each mask channel divided by its sum to the power `share`; the total is kept."""
    if share == 0.0:
        return views
    sums = sum(jax.ops.segment_sum(v.weight.reshape(-1), v.channel.reshape(-1), num_channels) for v in views)
    factor = jnp.where(sums > 0, jnp.maximum(sums, 1e-6) ** -share, 0.0)
    factor = factor * jnp.sum(sums) / jnp.maximum(jnp.sum(sums * factor), 1e-6)
    return tuple(eqx.tree_at(lambda v: v.weight, v, v.weight * factor[v.channel]) for v in views)
