"""Works on the road change what lies side by side, all at once (room: mapping; host).

In: the chain of looks at each thing. Out: how likely each goes or comes in each step, by what the others near by do.
A thing says nothing of itself: what is missed alone has not gone sooner. Where the rest of a crosswalk has been laid
elsewhere, few looks tell that this bar of it has, too.
"""

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from semloc_jax.mapping.crowd.looks_chain import ChangeRates, Looks, PresenceChain, PresenceConfig

_RATHER = 0.5


def things_near(looks: Looks, c: PresenceConfig) -> csr_array:
    """`[n n]` 1 for each two things that the same works would change, none of them itself."""
    n = len(looks.kind)
    if looks.place is None or n < 2:
        return csr_array((n, n))
    a, b = cKDTree(looks.place).query_pairs(c.works_m, output_type="ndarray").T
    return csr_array(coo_array((np.ones(2 * len(a)), (np.append(a, b), np.append(b, a))), shape=(n, n)))


def change_rates(
    looks: Looks, near: csr_array, chain: PresenceChain | None, vanish: float, c: PresenceConfig
) -> ChangeRates:
    """How likely each thing changes in each step.

    Args:
        looks: of which the time between drives counts.
        near: see `things_near`.
        chain: what the looks say so far; None for nothing.
        vanish: how likely any thing goes within a step.
        c: how things come and go.
    """
    go, come = (np.tile(1.0 - (1.0 - rate) ** looks.steps, (len(looks.kind), 1)) for rate in (vanish, c.appear))
    if chain is None:
        return ChangeRates(go, come)
    was = np.column_stack([np.zeros(len(go)), chain.present[:, :-1]])
    return ChangeRates(
        _local(near, go, chain.went, was, c.works_things, c.most_go),
        _local(near, come, chain.came, 1.0 - was, c.works_things, c.most_come),
    )


def _local(
    near: csr_array,
    everywhere: Float[np.ndarray, "n d"],
    changed: Float[np.ndarray, "n d"],
    could: Float[np.ndarray, "n d"],
    worth: float,
    most: float,
) -> Float[np.ndarray, "n d"]:
    """The share of the things near each one that changed of those that could, as much as their number says.

    Only what rather changed than not, whenever that was, speaks for works: what was missed now and then is none. And
    what changes by itself does so beside things that stay, as often as everywhere.
    """
    rather = np.where(changed.sum(axis=1, keepdims=True) > _RATHER, changed, 0.0)
    share = (worth * everywhere + near @ rather) / (worth + near @ could)
    return np.clip(share, everywhere, np.maximum(most, everywhere))
