"""Where a drive lies in what is known, from nothing but where satellite fixes put it (room: mapping; host).

In: a drive, a CrowdWorld. Out: its correction: first the shift that most of its things agree on, then along its way.
"""

import numpy as np
from scipy.spatial import cKDTree

from semloc_jax.mapping.crowd.correction import Correction
from semloc_jax.mapping.crowd.joint import JointSolve
from semloc_jax.mapping.crowd.seen import seen_by
from semloc_jax.mapping.crowd.world import CrowdWorld

_GATES_M = (2.0, 1.2, 0.8, 0.6, 0.5)
_REACH_M = 8.0
_TOGETHER_M = 0.8
_LEAST_SHARE, _LEAST_THINGS = 0.3, 4


def place(world: CrowdWorld, drive: Correction) -> bool:
    """Moves a drive to where it fits the world; whether it fits anywhere."""
    shift = _agreed_shift(world, drive)
    if shift is None:
        return False
    drive.value[:2] = shift
    for gate_m in _GATES_M:
        seen = seen_by(world, drive, gate_m)
        JointSolve(world, [drive], [seen], [1.0], world_moves=False).run()
    found = len(seen_by(world, drive, _GATES_M[-1]).pairs)
    return found >= max(_LEAST_THINGS, _LEAST_SHARE * _num_comparable(world, drive))


def _num_comparable(world: CrowdWorld, drive: Correction) -> int:
    """Things of a drive that the world could hold: what lies beyond its ends says nothing."""
    if not len(world.kind):
        return 0
    near = cKDTree(world.centre).query(drive.moved_things())[0] < _REACH_M
    return int(near.sum())


def _agreed_shift(world: CrowdWorld, drive: Correction) -> np.ndarray | None:
    """The shift that brings most things onto one of their kind [m]; None without any pair."""
    things, offsets = drive.sights.things, []
    for kind in sorted(set(things.kind.tolist()) & set(world.kind.tolist())):
        own, other = things.centre[things.kind == kind], world.centre[world.kind == kind]
        offset = (other[None] - own[:, None]).reshape(-1, 2)
        offsets.append(offset[np.linalg.norm(offset, axis=1) < _REACH_M])
    votes = np.concatenate([np.zeros((0, 2)), *offsets])
    if not len(votes):
        return None
    near = cKDTree(votes).query_ball_point(votes, _TOGETHER_M)
    sigma_m = min(np.hypot(drive.sights.sigma_place_m, 1.0), _REACH_M)
    prior = np.exp(-0.5 * (np.linalg.norm(votes, axis=1) / sigma_m) ** 2 / 4.0)
    score = np.array([len(own) for own in near]) * prior
    return votes[near[int(score.argmax())]].mean(axis=0)
