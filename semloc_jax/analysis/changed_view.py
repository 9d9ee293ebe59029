"""What the solver answers when elements of the map are moved or left out (room: analysis; JAX and host).

In: the evidence of one frame, groups of elements. Out: how far the pose moves for each of them, all in one call.
The view of the map is that of the frame: what is in it, and what it weighs, does not follow the change.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, align_one
from semloc_jax.analysis.expected import TANGENT_OF_DIRECTION
from semloc_jax.analysis.influence import OF_PART, PRIOR_PARTS
from semloc_jax.geometry import rigid
from semloc_jax.structs import ElementClass

_LOOSE = 100.0
"""A part of the prior that is left out has this many times its sigma."""


@dataclass(frozen=True)
class Group:
    """What is moved or left out together: rows of the elements in view, the parts of the prior behind them."""

    id: str
    label: ElementClass | None
    middle_map: np.ndarray
    rows: tuple[int, ...]

    @property
    def is_element(self) -> bool:
        """Whether it is an element of the map, or a class of them."""
        return self.label is not None


def cast(leaf: Array | np.ndarray, dtype: np.dtype) -> Array | np.ndarray:
    """The leaf in another float type; other leaves are unchanged."""
    return leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf


class Lanes(eqx.Module):
    """Changed problems, one for each lane."""

    chosen: Bool[Array | np.ndarray, "*lane element"]
    """Elements that are changed."""
    shift_map: Float[Array | np.ndarray, "*lane 3"]
    """By how much they are moved, or the prior [m]."""
    is_prior: Bool[Array | np.ndarray, "*lane"]
    """Whether the prior is moved instead."""
    sigma: Float[Array | np.ndarray, "*lane 6"]
    """Of the prior."""
    keep: Float[Array | np.ndarray, "*lane"]
    """What the elements that are changed weigh, as a share of what they did."""


@partial(jax.jit, static_argnames="config")
def _solve(
    lanes: Lanes,
    T_start: Float[Array, "4 4"],
    evidence: Evidence,
    prior: Prior,
    holder: tuple[Int[Array, "cam p"], ...],
    config: AlignConfig,
) -> Float[Array, "lane 4 4"]:
    """The pose of every changed problem, from one start, in one view of the map."""

    def one(lane: Lanes) -> Array:
        views = []
        for part, element in zip(evidence.views, holder, strict=True):
            is_chosen = lane.chosen[element] & (element >= 0)
            p_map = part.p_map + jnp.where(is_chosen[:, None], lane.shift_map[:, None], 0.0)
            weight = jnp.where(is_chosen, lane.keep * part.weight, part.weight)
            views.append(eqx.tree_at(lambda v: (v.p_map, v.weight), part, (p_map, weight)))
        changed = eqx.tree_at(lambda e: e.views, evidence, tuple(views))
        T_prior = prior.T_local_base.at[:3, 3].add(jnp.where(lane.is_prior, lane.shift_map, 0.0))
        return align_one(T_start, changed, Prior(T_prior, lane.sigma), config).T_local_base

    return jax.lax.map(one, lanes)


def resolve(
    T_start: Float[np.ndarray, "4 4"],
    evidence: Evidence,
    prior: Prior,
    holder: tuple[Int[Array, "cam p"], ...],
    config: AlignConfig,
    groups: Sequence[Group],
    capacity: int,
    step_map: Float[np.ndarray, "group 3"],
) -> tuple[Float[np.ndarray, "group 1"], Float[np.ndarray, "group 3"], Float[np.ndarray, "group 3"]]:
    """How the pose moves when each group is shifted, and when it is left out.

    Each is shifted both ways; of both the one counts that moves the vehicle farther.

    Args:
        T_start: Where every solve starts, relative to the local origin.
        evidence: The view of the map that is changed.
        prior: Prior of the pose.
        holder: Number of the element of each sample of each view, -1 for padding.
        config: The solver's.
        groups: What is changed.
        capacity: Number of elements that the program is compiled for.
        step_map: Shift of each group in the map [m].

    Returns:
        +1 or -1 for each group, the way along `step_map` that moves the vehicle farther; what it does to longitudinal
        [m], lateral [m] and heading [rad]; what leaving the group out does to them.
    """
    # As many for elements as for classes: one program for both.
    count, num = capacity + len(PRIOR_PARTS), len(groups)
    sigma = np.asarray(prior.sigma, np.float64)
    chosen, shift, of_prior = np.zeros((count, capacity), bool), np.zeros((count, 3)), np.zeros(count, bool)
    loose = np.tile(sigma, (count, 1))
    for k, group in enumerate(groups):
        shift[k], of_prior[k] = step_map[k], not group.is_element
        if group.is_element:
            chosen[k, list(group.rows)] = True
        else:
            loose[k] = np.where(OF_PART[PRIOR_PARTS.index(group.id)], _LOOSE * sigma, sigma)
    ones, firm, still = np.ones(count), np.tile(sigma, (count, 1)), np.zeros((count, 3))
    lanes = (
        Lanes(chosen, shift, of_prior, firm, ones),
        Lanes(chosen, -shift, of_prior, firm, ones),
        Lanes(chosen, still, of_prior, loose, np.zeros(count)),
        Lanes(chosen, still, of_prior, firm, ones),
    )
    dtype = prior.sigma.dtype
    given = (jnp.asarray(T_start, dtype), evidence, prior, holder, config)
    ahead, back, without, base = (
        np.asarray(_solve(jax.tree.map(partial(cast, dtype=dtype), part), *given), np.float64)[:num] for part in lanes
    )
    ahead, back, without = (
        rigid.log(rigid.inverse(base) @ Ts)[:, TANGENT_OF_DIRECTION] for Ts in (ahead, back, without)
    )
    is_ahead = (np.hypot(*ahead[:, :2].T) >= np.hypot(*back[:, :2].T))[:, None]
    return np.where(is_ahead, 1.0, -1.0), np.where(is_ahead, ahead, back), without
