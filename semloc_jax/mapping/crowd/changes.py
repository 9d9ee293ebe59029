"""What came, went and moved while drives went by (room: mapping; host).

In: things as elements, who saw them, what is there. Out: elements with their ids kept, CrowdChange.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from semloc_jax.evaluation.map_shapes import kind_of
from semloc_jax.mapping.crowd.looks_chain import Looks
from semloc_jax.mapping.crowd.presence import Presence
from semloc_jax.maps import MapElement

_HARDLY = 0.2
"""Probability below which a thing counts as not having been there yet; ours."""


@dataclass(frozen=True)
class ChangeConfig:
    """What counts as a change. All values are ours.

    Args:
        identity_m: what went and came again no farther away is one thing that moved.
        moved_m: less is no move.
    """

    identity_m: float = 1.0
    moved_m: float = 0.3


@dataclass(frozen=True)
class CrowdChange:
    """One thing that changed while the drives went by.

    Attributes:
        id: of the element.
        change: added, removed or moved.
        element: as it is, or as it was.
        existence: probability that it is there now.
        moved_m: how far it moved.
        drive: name of the first drive after which more spoke for the change than against it.
        num_seen, num_missed: drives that saw it, and that would have.
    """

    id: str
    change: str
    element: MapElement
    existence: float
    moved_m: float
    drive: str
    num_seen: int
    num_missed: int


def identified(
    elements: Sequence[MapElement], looks: Looks, there: Presence, names: Sequence[str], config: ChangeConfig
) -> tuple[list[MapElement], list[CrowdChange]]:
    """What went and came again near by is one thing that moved: it keeps its id. And all changes.

    Args:
        elements: all things.
        looks: at them.
        there: what the looks say.
        names: of the drives, in the order of the looks.
        config: what counts as a change.
    """
    gone = np.flatnonzero(there.was & ~there.stays)
    looked = np.where(looks.visible | looks.seen, there.then, 1.0).min(axis=1, initial=1.0)
    is_new = (looked < _HARDLY) | bool(looks.is_based.any())
    came = np.flatnonzero(there.stays & is_new & ~looks.is_based)
    links = _links(elements, came, gone, config.identity_m)
    kept = list(elements)
    for new, (old, _) in links.items():
        kept[new] = replace(elements[new], id=elements[old].id)
    linked = {old for old, _ in links.values()}
    changes = [_change(kept, looks, there, names, k, "removed", 0.0) for k in gone.tolist() if k not in linked]
    for k in came.tolist():
        old, moved_m = links.get(k, (-1, 0.0))
        if old < 0 or moved_m >= config.moved_m:
            changes.append(_change(kept, looks, there, names, k, "added" if old < 0 else "moved", moved_m))
    return kept, changes


def _links(
    elements: Sequence[MapElement], came: np.ndarray, gone: np.ndarray, reach_m: float
) -> dict[int, tuple[int, float]]:
    """Which thing that went each one that came is, and how far apart they are [m]."""
    if not len(gone) or not len(came):
        return {}
    middle = np.array([e.points[:, :2].mean(axis=0) for e in elements]).reshape(-1, 2)
    apart = np.linalg.norm(middle[came][:, None] - middle[gone][None], axis=2)
    same = np.array([[kind_of(elements[a]) == kind_of(elements[b]) for b in gone] for a in came])
    apart = np.where(same, apart, np.inf)
    rows, columns = linear_sum_assignment(np.minimum(apart, reach_m))
    links = {int(came[i]): (int(gone[j]), float(apart[i, j])) for i, j in zip(rows, columns, strict=True)}
    return {k: v for k, v in links.items() if v[1] < reach_m}


def _change(
    elements: Sequence[MapElement],
    looks: Looks,
    there: Presence,
    names: Sequence[str],
    k: int,
    what: str,
    moved_m: float,
) -> CrowdChange:
    then = there.then[k] > 0.5
    flips = np.flatnonzero(then[1:] != then[:-1])
    drive = names[int(flips[-1]) + 1] if len(flips) else names[-1]
    counts = looks.counts[k].tolist()
    return CrowdChange(elements[k].id, what, elements[k], float(there.now[k]), moved_m, drive, *counts)
