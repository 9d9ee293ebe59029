"""What parts of the map cost, each alone, beside a pose: lines and posts, lines to the left and to the right (room:
alignment; pure JAX).

In: a solved pose, one frame, which elements stand upright. Out: costs of every group of elements, at moved poses.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.alignment.pieces import nats_of_groups
from semloc_jax.alignment.proposals import displaced
from semloc_jax.alignment.single_frame import FrameInput
from semloc_jax.alignment.tracking_step import TrackAlignConfig, trusted_evidence
from semloc_jax.geometry import lie
from semloc_jax.runtime.stored_program import stored_program

GROUPS = ("lines", "posts", "left side", "right side")
"""What lies on the road and what stands; what lies on the road to the left of the vehicle and to its right."""


@stored_program("config", "level")
def class_profiles(
    T_local_base: Float[Array, "4 4"],
    moves: Float[Array, "n 3"],
    frame: FrameInput,
    is_upright: Float[Array, " element"],
    config: TrackAlignConfig,
    level: int,
) -> Float[Array, "4 n"]:
    """Costs [nats] of every one of `GROUPS`, against the pose itself.

    Args:
        T_local_base: Solved pose, relative to the local origin.
        moves: Forward [m], left [m], turned [rad].
        frame: Samples, cost maps, cameras.
        is_upright: 1 for the elements that stand, 0 for those that lie on the road. All are trusted: what is outdated
            would otherwise fall silent before it is told.
        config: View, loss and noise.
        level: Of the cost maps.
    """
    evidence, element = trusted_evidence(T_local_base, frame, jnp.ones_like(is_upright), config.view)
    stands = jnp.concatenate(
        [jnp.where(owner >= 0, is_upright[jnp.clip(owner, 0)], 0.0).reshape(-1) for owner in element]
    )
    left_m = jnp.concatenate([_left_of(T_local_base, view.p_map).reshape(-1) for view in evidence.views])
    lies = 1.0 - stands
    groups = jnp.stack([lies, stands, lies * (left_m > 0.0), lies * (left_m <= 0.0)])
    moved = displaced(T_local_base, moves.astype(T_local_base.dtype))
    slides = jnp.array([name.endswith("side") for name in GROUPS])
    return nats_of_groups(moved, T_local_base, level, evidence, groups, slides, config.align)


def _left_of(T_local_base: Float[Array, "4 4"], p_map: Float[Array, "cam 3 p"]) -> Float[Array, "cam p"]:
    """How far points lie to the left of the vehicle [m]."""
    T = lie.inverse(T_local_base)
    return jnp.einsum("i,cip->cp", T[1, :3], p_map) + T[1, 3]
