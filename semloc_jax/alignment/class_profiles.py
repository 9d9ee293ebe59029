"""What lines and posts cost, each class alone, beside a pose (room: alignment; pure JAX).

In: a solved pose, one frame, which elements stand upright. Out: costs of what lies and of what stands, at moved poses.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.alignment.pieces import nats_at
from semloc_jax.alignment.pose import Evidence
from semloc_jax.alignment.proposals import displaced
from semloc_jax.alignment.single_frame import FrameInput
from semloc_jax.alignment.tracking_step import TrackAlignConfig, trusted_evidence
from semloc_jax.runtime.stored_program import stored_program


@stored_program("config", "level")
def class_profiles(
    T_map_base: Float[Array, "4 4"],
    moves: Float[Array, "n 3"],
    frame: FrameInput,
    is_upright: Float[Array, " element"],
    config: TrackAlignConfig,
    level: int,
) -> Float[Array, "2 n"]:
    """Costs [nats], against seeing the map by chance, of what lies and of what stands.

    Args:
        T_map_base: Solved pose, relative to the local origin.
        moves: Forward [m], left [m], turned [rad].
        frame: Samples, cost maps, cameras.
        is_upright: 1 for the elements that stand, 0 for those that lie on the road. All are trusted: what is outdated
            would otherwise fall silent before it is told.
        config: View, kernel and noise.
        level: Of the cost maps.
    """
    evidence, element = trusted_evidence(T_map_base, frame, jnp.ones_like(is_upright), config.view)
    stands = [jnp.where(owner >= 0, is_upright[jnp.clip(owner, 0)], 0.0) for owner in element]
    moved = displaced(T_map_base, moves.astype(T_map_base.dtype))

    def costs(shares: list[Float[Array, "cam p"]]) -> Float[Array, " n"]:
        return jnp.sum(nats_at(moved, T_map_base, level, _weighed(evidence, shares), config.align), axis=1)

    return jax.lax.map(costs, [jnp.stack([1.0 - share, share]) for share in stands])


def _weighed(evidence: Evidence, shares: list[Float[Array, "cam p"]]) -> Evidence:
    """The evidence with a factor on the weight of every sample."""
    views = tuple(
        eqx.tree_at(lambda v: v.weight, view, view.weight * share.astype(view.weight.dtype))
        for view, share in zip(evidence.views, shares, strict=True)
    )
    return eqx.tree_at(lambda e: e.views, evidence, views)
