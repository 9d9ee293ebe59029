"""The search of one frame, stage by stage, to be looked at (room: analysis; host).

In: what `FrameLocalizer.localize` takes. Out: the hypotheses that each stage leaves, in the map frame.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.hypotheses import cull, refine_and_score
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.single_frame import evidence_from, search_starts
from semloc_jax.cameras import Rig


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
    evidence = evidence_from(around.T_map_base, inputs, config.search_view)
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
