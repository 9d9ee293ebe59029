"""One frame against the map: propose, search, polish where it looks right (room: localization; JAX).

In: map samples, cost maps, prior. Out: Modes. This is the whole of a single-frame localization, compiled as one function.
"""

from dataclasses import dataclass, field
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from semloc_jax.cameras import Rig
from semloc_jax.residuals.alignment import Usable, camera_views
from semloc_jax.residuals.texture import RampTextures, pack
from semloc_jax.residuals.view import ViewConfig, view
from semloc_jax.solvers.hypotheses import Modes, SearchConfig, score, search, weigh
from semloc_jax.solvers.pose import AlignConfig, Evidence, Prior, align
from semloc_jax.solvers.proposals import ProposalKind, propose
from semloc_jax.structs import CostMaps, MapSamples, PoseEstimate


@dataclass(frozen=True)
class SingleFrameConfig:
    """How one frame is localized from a wide prior. All values are ours."""

    num_hypotheses: int = 1024
    proposals: ProposalKind = "lattice"
    reach: float = 2.5
    """Half width of the search window in sigmas of the prior."""
    search_view: ViewConfig = field(default_factory=lambda: ViewConfig(margin_share=0.15))
    polish_view: ViewConfig = field(default_factory=ViewConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    search_align: AlignConfig = field(default_factory=AlignConfig)
    polish_align: AlignConfig = field(default_factory=lambda: AlignConfig(levels=(2, 3), max_steps=10))
    rank_level: int = 2
    """Level on which the polished modes are ranked."""


@partial(jax.jit, static_argnames="config")
def localize_view(
    samples: MapSamples,
    maps: CostMaps,
    rig: Rig,
    prior: Prior,
    channel_of_label: Int[Array, " label"],
    key: PRNGKeyArray,
    always: Bool[Array, "2"],
    config: SingleFrameConfig,
) -> Modes:
    """Modes of the pose of one frame, best first.

    Args:
        samples: Map samples relative to the local origin.
        maps: Cost maps of all cameras.
        rig: Cameras.
        prior: Prior pose and its sigmas; the plane of its x and y axes is taken as the road.
        channel_of_label: Cost-map channel of each ElementClass, -1 for none.
        key: Random key of the proposals.
        always: True twice; see `semloc_jax.residuals.fusion_barrier`.
        config: Hypotheses, schedule, refinement.
    """
    textures = pack(maps)
    usable = Usable(jnp.asarray(maps.usable), maps.usable_stride)

    def evidence_from(T_map_base: Array, view_config: ViewConfig) -> Evidence:
        seen = view(samples, T_map_base, rig, channel_of_label, view_config)
        return Evidence(camera_views(rig, seen), textures, usable, always)

    wide = evidence_from(prior.T_map_base, config.search_view)
    Ts = propose(
        config.proposals, config.num_hypotheses, prior.T_map_base, prior.sigma[jnp.array([0, 1, 5])], config.reach, key
    )
    candidates, scores = search(Ts, wide, prior, config.search_align, config.search)

    def polish(T_map_base: Array) -> tuple[PoseEstimate, Array]:
        # Contours, density and visibility as they are from here, no longer from the centre of the prior.
        evidence = evidence_from(T_map_base, config.polish_view)
        estimate = align(T_map_base, evidence, prior, config.polish_align)
        return estimate, score(estimate.T_map_base, config.rank_level, evidence, prior, config.polish_align)

    estimates, polished = jax.lax.map(polish, candidates)
    return weigh(estimates, jnp.where(jnp.isfinite(scores), polished, jnp.inf))
