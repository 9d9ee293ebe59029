"""Two things do not lie in one place (room: mapping; host).

In: what the looks say of each thing alone, where they lie. Out: what they say when of two that overlap, and that no
drive has seen together, one at most is there. So what is painted anew takes the place of the old paint at once, and a
piece of a bar that stands alone is no bar beside it.
"""

from dataclasses import replace

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from semloc_jax.evaluation.map_shapes import POST_NAMES
from semloc_jax.mapping.crowd.changes import ChangeConfig
from semloc_jax.mapping.crowd.looks_chain import Looks, PresenceConfig
from semloc_jax.mapping.crowd.presence import Presence, belongs
from semloc_jax.mapping.crowd.world import CrowdWorld

_WIDER_M = 0.1
"""By how much a place may be off."""
_SHARE = 0.2
"""So much of the smaller of two lies in the other; ours, as the length above."""
_ROOM_M = 0.6
"""Posts of a kind do not stand so close, nor do signs hang so on two posts; ours."""
_NONE = np.zeros((0, 2), dtype=np.int64)
_REPLACED = 5.0
"""Paint that goes is laid anew beside its place so many times as often as paint comes by itself; ours."""
_SURE = 0.995
"""No existence counts as surer against another thing: what stands in its place may be it."""
_ELSEWHERE_M = ChangeConfig().moved_m
"""What lies nearer to the old paint was not laid anew: a drive has placed the old one so."""


def one_in_each_place(
    world: CrowdWorld,
    looks: Looks,
    there: Presence,
    config: PresenceConfig,
    placed: Bool[np.ndarray, " n"] | None = None,
) -> Presence:
    """Presence of things, each given that what overlaps it is not there with it.

    Args:
        world: where they lie.
        looks: who looked at them.
        there: presence of each alone.
        config: how things come and go.
        placed: which of them a map may hold: a part takes no place from what is whole; None for all.
    """
    p = np.clip(there.now, 0.0, _SURE)
    odds, others = p / (1.0 - p), np.zeros(len(p))
    rivals = _rivals(world, looks)
    a, b = np.concatenate([rivals, rivals[:, ::-1]]).T
    first = np.where(looks.is_based, -1, looks.seen.argmax(axis=1)) if looks.seen.shape[1] else np.zeros(len(p))
    # Against the old paint the new one weighs more, if it is rather there; against nothing at all it does not.
    is_anew = np.linalg.norm(world.centre[a] - world.centre[b], axis=1) > _ELSEWHERE_M
    is_new = is_anew & there.was[a] & (first[b] > first[a]) & (there.now[b] > 0.5)
    is_old = is_anew & there.was[b] & (first[a] > first[b]) & (there.now[a] > 0.5)
    weight = np.where(is_new, _REPLACED, np.where(is_old, 1.0 / _REPLACED, 1.0))
    np.add.at(others, a, weight * odds[b])
    now = np.where(others > 0.0, odds / (1.0 + odds + others), there.now)
    rivals = rivals if placed is None else rivals[placed[rivals].all(axis=1)]
    return replace(there, now=now, stays=_likeliest(belongs(now, there.was, config), now, rivals))


def _likeliest(
    stays: Bool[np.ndarray, " n"], now: Float[np.ndarray, " n"], rivals: Int[np.ndarray, "k 2"]
) -> Bool[np.ndarray, " n"]:
    """What stays when of two in one place only the likelier does; of two alike the one known first."""
    stays, beside = stays.copy(), dict[int, list[int]]()
    for a, b in rivals.tolist():
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    for k in sorted(beside, key=lambda k: (-now[k], k)):
        if stays[k]:
            stays[beside[k]] = False
    return stays


def _rivals(world: CrowdWorld, looks: Looks) -> Int[np.ndarray, "k 2"]:
    """Pairs of things of a kind in one place that no drive has seen together, nor a base map both names."""
    flat = np.flatnonzero(world.half_m.max(axis=1, initial=0.0) > 0.0)
    outlines = shapely.polygons(_corners(world, flat)) if len(flat) else np.zeros(0, dtype=object)
    a, b = shapely.STRtree(outlines).query(outlines, predicate="intersects")
    shared = shapely.area(shapely.intersection(outlines[a], outlines[b]))
    least = np.minimum(shapely.area(outlines[a]), shapely.area(outlines[b]))
    a, b, lies = flat[a], flat[b], shared > _SHARE * least
    stands = np.flatnonzero(np.isin(world.kind.astype(str), sorted(POST_NAMES)))
    close = cKDTree(world.centre[stands]).query_pairs(_ROOM_M, output_type="ndarray") if len(stands) > 1 else _NONE
    a, b = np.concatenate([a, stands[close[:, 0]]]), np.concatenate([b, stands[close[:, 1]]])
    lies = np.concatenate([lies, np.ones(len(close), dtype=bool)])
    together = (looks.seen[a] & looks.seen[b]).any(axis=1) | (looks.is_based[a] & looks.is_based[b])
    chosen = (a < b) & lies & (world.kind[a] == world.kind[b]) & ~together
    return np.stack([a[chosen], b[chosen]], axis=1)


def _corners(world: CrowdWorld, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 2"]:
    """Outlines of things, a little wider than they are."""
    ahead = world.along[rows]
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    half = world.half_m[rows] + np.array([0.0, _WIDER_M])
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    return world.centre[rows, None] + np.einsum("ca,na,nak->nck", signs, half, np.stack([ahead, aside], axis=1))
