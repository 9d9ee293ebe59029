"""The cost around a pose over two of its six directions, and the search stage by stage (room: analysis; JAX).

In: evidence of one frame, a pose, offsets; what `FrameLocalizer.localize` takes. Out: robust costs on a grid, all
classes together and each alone; the hypotheses that each stage leaves, in the map frame.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.hypotheses import cull, refine_and_score
from semloc_jax.alignment.pose import AlignConfig, Evidence
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.single_frame import evidence_from, search_starts
from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import lie
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.scoring import robust_cost
from semloc_jax.runtime.stored_program import stored_program

DIRECTIONS = ("x", "y", "z", "roll", "pitch", "yaw")
"""Names of the six directions in the order of the right tangent."""


def cost_landscape(
    T_local_base: Float[np.ndarray | Array, "4 4"],
    evidence: Evidence,
    directions: tuple[str, str],
    offset_a: Float[np.ndarray, " na"],
    offset_b: Float[np.ndarray, " nb"],
    level: int,
    config: AlignConfig,
    channel: int | None = None,
) -> Float[np.ndarray, "na nb"]:
    """Robust cost in [0, 1] of every pose T_local_base exp(a e_i + b e_j): 0 explains all map in view, 1 nothing.

    The cost is normalised by what is visible from each pose; where less than `config.min_visible_px` of contour is
    visible it is NaN.

    Args:
        T_local_base: Pose in the middle of the grid, relative to the local origin.
        evidence: What the cameras saw; take views with a margin, since they are kept for the whole grid.
        directions: Two of `DIRECTIONS`.
        offset_a, offset_b: Offsets along them [m or rad].
        level: Level of the cost maps.
        config: Robust loss and limits.
        channel: Mask channel that is scored alone; None scores all of them.

    Raises:
        SemlocError: a direction has no such name, or both are the same.
    """
    unknown = [name for name in directions if name not in DIRECTIONS]
    if unknown or directions[0] == directions[1]:
        raise SemlocError(
            f"landscape over {', '.join(directions)}; expected two different ones of {', '.join(DIRECTIONS)}"
        )
    xi = np.zeros((len(offset_a), len(offset_b), 6), np.float32)
    xi[..., DIRECTIONS.index(directions[0])] += np.asarray(offset_a, np.float32)[:, None]
    xi[..., DIRECTIONS.index(directions[1])] += np.asarray(offset_b, np.float32)[None, :]
    if channel is not None:
        only = [eqx.tree_at(lambda v: v.weight, v, v.weight * (v.channel == channel)) for v in evidence.views]
        evidence = eqx.tree_at(lambda e: e.views, evidence, tuple(only))
    T = jnp.asarray(T_local_base, jnp.float32)
    cost = costs_around(jnp.asarray(xi.reshape(-1, 6)), T, evidence, np.int32(level), config)
    return np.asarray(cost).reshape(xi.shape[:2])


def frame_landscape(
    localizer: FrameLocalizer,
    masks: Sequence[np.ndarray],
    rig: Rig,
    T_map_base: np.ndarray,
    directions: tuple[str, str],
    offset_a: np.ndarray,
    offset_b: np.ndarray,
    level: int = 1,
) -> dict[str, np.ndarray]:
    """Costs of one frame around a pose: `all` classes together, then each mask channel that is in view alone.

    Args:
        localizer: Map, class table and configuration.
        masks: Class ids of every camera of the rig.
        rig: Cameras of the masks.
        T_map_base: Pose in the middle, in the map frame.
        directions, offset_a, offset_b, level: See `cost_landscape`.

    Raises:
        SemlocError: wrong directions, or a level that the cost maps do not have.
    """
    num_levels = len(localizer.config.cost_maps.ramp_px)
    if not 0 <= level < num_levels:
        raise SemlocError(f"landscape on level {level}; the cost maps have the levels 0 (coarse) to {num_levels - 1}")
    inputs, local_map = localizer.prepare(masks, rig, T_map_base)
    T_local_base = local_map.frame.from_map(T_map_base, np.float64)
    evidence = evidence_from(jnp.asarray(T_local_base, jnp.float32), inputs, localizer.config.frame.search_view)
    config = localizer.config.frame.search_align
    channels = {"all": None} | {channel.name: index for index, channel in enumerate(localizer.shown.channels)}
    costs = {
        name: cost_landscape(T_local_base, evidence, directions, offset_a, offset_b, level, config, index)
        for name, index in channels.items()
    }
    return {name: cost for name, cost in costs.items() if name == "all" or np.isfinite(cost).any()}


@stored_program("config")
def costs_around(
    xi: Float[Array | np.ndarray, "n 6"],
    T_local_base: Float[Array, "4 4"],
    evidence: Evidence,
    level: Int[Array | np.ndarray, ""],
    config: AlignConfig,
) -> Float[Array, " n"]:
    """Robust cost in [0, 1] of the poses T_local_base exp(xi); NaN where too little is seen; see `cost_landscape`."""
    texture = evidence.textures.level(level)

    def one(offset: Array) -> Array:
        pose, loss = T_local_base @ lie.exp(offset), LOSSES[config.loss]
        cost = robust_cost(pose, evidence.views, texture, evidence.usable, loss, config.border_px, config.path)
        enough = cost.visible >= config.min_visible_px
        return jnp.where(enough, cost.summed / jnp.maximum(cost.visible, 1e-6), jnp.nan)

    return jax.lax.map(one, xi, batch_size=min(32, xi.shape[0]))


def trace_search(
    localizer: FrameLocalizer, masks: Sequence[np.ndarray], rig: Rig, prior: PosePrior
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Poses T_map_base `[n 4 4]` and scores `[n]` [nats] of the proposals and after each stage, by the stage's name.

    An empty place has an infinite score. The polish that ends a localization is not part of the search.

    Args:
        localizer: Map, class table and configuration.
        masks: Class ids of every camera of the rig.
        rig: Cameras of the masks.
        prior: First guess.
    """
    config = localizer.config.frame
    T_map_prior = prior.on_road(localizer.map)
    inputs, local_map = localizer.prepare(masks, rig, T_map_prior)
    spread = localizer.map.road_spread(T_map_prior)
    around = prior.to_solver(T_map_prior, local_map.frame, localizer.config.road, spread)
    evidence = evidence_from(around.T_local_base, inputs, config.search_view)
    Ts = search_starts(around, config)
    first = config.search.stages[0]
    level, align, chunk = jnp.asarray(first.score_level), config.search_align, config.search.chunk
    found = {f"{len(Ts)} proposals": refine_and_score(Ts, level, evidence, around, align, chunk)}
    for number, stage in enumerate(config.search.stages, start=1):
        Ts, scores = cull(Ts, stage, evidence, around, align, chunk)
        left = int(np.isfinite(scores).sum())
        ramps = ", ".join(f"{localizer.config.cost_maps.ramp_px[index]:g}" for index in stage.levels)
        done = f"refined on ramps of {ramps} px" if ramps else "scored"
        found[f"stage {number}: {done}, {left} left"] = Ts, scores
    return {name: (local_map.frame.to_map(Ts), np.asarray(scores)) for name, (Ts, scores) in found.items()}
