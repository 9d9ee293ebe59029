"""Where a drive lies in what is known, from nothing but where satellite fixes put it (room: mapping; host).

In: a drive, a CrowdWorld. Out: its correction. First the shift and turn that most things of a stretch of its way agree
on: a degree is 3 m at the end of 350 m, and there the next lane fits as well. Then from that stretch on, to both sides:
how a way bends is known a little beyond what lies in place already, not at its far end.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from semloc_jax.mapping.crowd.correction import TURN, Correction, turned
from semloc_jax.mapping.crowd.joint import JointSolve
from semloc_jax.mapping.crowd.seen import Seen, seen_by
from semloc_jax.mapping.crowd.world import CrowdWorld

_FIRST_GATES_M, _NEXT_GATES_M, _LAST_GATES_M = (2.0, 1.2, 0.8), (1.2, 0.8), (0.6, 0.5)
_REACH_M = 8.0
_TOGETHER_M = 0.8
_STRETCH_M, _FARTHER_M = 300.0, 100.0
"""Over so long a stretch two ways bend by less than half a lane against each other; so far beyond what lies in place
they do not miss theirs; ours."""
_TURN_SIGMAS = 4.0
"""Two drives, each turned by its own error, are hardly turned against each other by more times that of one; ours."""
_WORTH_A_TRY, _MOST_TRIED, _OTHER_M = 0.4, 6, 1.0
"""Tried is what so large a share of what speaks for the best speaks for, at most so many, each so far off
the others; ours."""
MOST_STRAIN = 4.0
"""Ways that lie where they belong have 0.1 to 0.5, those with an end on another lane 12 and more."""
_LEAST_SHARE, _LEAST_THINGS = 0.3, 4


class _Motion(NamedTuple):
    """A motion that brings things of a stretch of the way onto some of their kind."""

    score: float
    low_m: float
    high_m: float
    shift: Float[np.ndarray, "2"]
    turn_rad: float


def place(world: CrowdWorld, drive: Correction) -> bool:
    """Moves a drive to where it fits the world; whether it fits anywhere.

    One that fits only where its way is bent as none is was laid onto the next lane: then the next motion is tried.
    """
    things_m = drive.sights.feet(drive.sights.things.centre)[0]
    return any(_placed(world, drive, motion, things_m) for motion in _distinct(_motions(world, drive, things_m)))


def _placed(world: CrowdWorld, drive: Correction, motion: _Motion, things_m: np.ndarray) -> bool:
    """Lays a drive onto the world from a stretch of its way on; whether it fits there."""
    drive.value[:] = 0.0
    drive.value[:2], drive.value[TURN] = motion.shift, motion.turn_rad
    low_m, high_m = motion.low_m, motion.high_m
    for gate_m in _FIRST_GATES_M:
        _fit(world, drive, gate_m, things_m, low_m, high_m)
    while low_m > 0.0 or high_m < drive.length_m:
        low_m, high_m = low_m - _FARTHER_M, high_m + _FARTHER_M
        for gate_m in _NEXT_GATES_M:
            _fit(world, drive, gate_m, things_m, low_m, high_m)
    for gate_m in _LAST_GATES_M:
        _fit(world, drive, gate_m, things_m, -np.inf, np.inf)
    found = len(seen_by(world, drive, _LAST_GATES_M[-1]).pairs)
    fits = found >= max(_LEAST_THINGS, _LEAST_SHARE * _num_comparable(world, drive))
    return fits and drive.strain < MOST_STRAIN


def _fit(
    world: CrowdWorld, drive: Correction, gate_m: float, things_m: np.ndarray, low_m: float, high_m: float
) -> None:
    """Lays a drive onto the world by what it saw along a stretch of its way."""
    seen = seen_by(world, drive, gate_m)
    places_m = drive.sights.feet(seen.places[:, :2])[0]
    pairs = (things_m[seen.pairs[:, 0]] >= low_m) & (things_m[seen.pairs[:, 0]] <= high_m)
    places = (places_m >= low_m) & (places_m <= high_m)
    own = Seen(seen.pairs[pairs], seen.line[places], seen.station[places], seen.places[places], seen.sigma_m[places])
    JointSolve(world, [drive], [own], [1.0], world_moves=False).run()


def _num_comparable(world: CrowdWorld, drive: Correction) -> int:
    """Things of a drive that the world could hold: what lies beyond its ends says nothing."""
    if not len(world.kind):
        return 0
    near = cKDTree(world.centre).query(drive.moved_things())[0] < _REACH_M
    return int(near.sum())


def _distinct(motions: list[_Motion]) -> Iterator[_Motion]:
    """The best motions, each another one than those before."""
    tried: list[_Motion] = []
    for motion in sorted(motions, key=lambda m: -m.score):
        if tried and motion.score < _WORTH_A_TRY * tried[0].score:
            return
        is_other = [m.low_m != motion.low_m or _apart_m(m, motion) > _OTHER_M for m in tried]
        if all(is_other) and len(tried) < _MOST_TRIED:
            tried.append(motion)
            yield motion


def _apart_m(a: _Motion, b: _Motion) -> float:
    """How far apart two motions lay the things of one stretch, root mean square over its length [m]."""
    return float(
        np.hypot(np.linalg.norm(a.shift - b.shift), (a.turn_rad - b.turn_rad) * (a.high_m - a.low_m) / 12**0.5)
    )


def _motions(world: CrowdWorld, drive: Correction, things_m: np.ndarray) -> list[_Motion]:
    """For each stretch of the way and each turn the motion that most of its things agree on."""
    num = max(round(2.0 * drive.length_m / _STRETCH_M) - 1, 1)
    half_m = 0.5 * drive.length_m if num == 1 else 0.5 * _STRETCH_M
    found = []
    for middle_m in np.linspace(half_m, drive.length_m - half_m, num).tolist():
        low_m, high_m = middle_m - half_m, middle_m + half_m
        rows = np.flatnonzero((things_m >= low_m) & (things_m <= high_m))
        for shift, turn_rad, score in _agreed_motions(world, drive, rows):
            found.append(_Motion(score, low_m, high_m, shift, turn_rad))
    return found


def _agreed_motions(
    world: CrowdWorld, drive: Correction, rows: np.ndarray
) -> Iterator[tuple[np.ndarray, float, float]]:
    """By turn [rad] the shift [m] that brings most of some things onto one of their kind, and what speaks for both."""
    if not len(rows):
        return
    lever = drive.sights.things.centre[rows] - drive.centre
    sigma_rad, far_m = drive.config.turn_rad, float(np.linalg.norm(lever.std(axis=0)))
    num = int(np.ceil(_TURN_SIGMAS * sigma_rad * far_m / _TOGETHER_M))
    for turn_rad in (_TURN_SIGMAS * sigma_rad * np.arange(-num, num + 1) / max(num, 1)).tolist():
        # It is turned about the middle of the drive, and shifted back by what that moves these things.
        moved = turn_rad * turned(lever)
        shift, score = _agreed_shift(world, drive, rows, moved - moved.mean(axis=0))
        if score > 0.0:
            score *= float(np.exp(-0.5 * (turn_rad / sigma_rad) ** 2 / 4.0))
            yield shift - moved.mean(axis=0), turn_rad, score


def _agreed_shift(
    world: CrowdWorld, drive: Correction, rows: np.ndarray, moved: np.ndarray
) -> tuple[np.ndarray, float]:
    """The shift that brings most of some things, so moved, onto one of their kind [m], and what speaks for it."""
    things, offsets = drive.sights.things, []
    kinds, centre = things.kind[rows], things.centre[rows] + moved
    for kind in sorted(set(kinds.tolist()) & set(world.kind.tolist())):
        own, other = centre[kinds == kind], world.centre[world.kind == kind]
        offset = (other[None] - own[:, None]).reshape(-1, 2)
        offsets.append(offset[np.linalg.norm(offset, axis=1) < _REACH_M])
    votes = np.concatenate([np.zeros((0, 2)), *offsets])
    if not len(votes):
        return np.zeros(2), 0.0
    tree = cKDTree(votes)
    num = tree.query_ball_point(votes, _TOGETHER_M, return_length=True)
    sigma_m = min(np.hypot(drive.sights.sigma_place_m, 1.0), _REACH_M)
    score = num * np.exp(-0.5 * (np.linalg.norm(votes, axis=1) / sigma_m) ** 2 / 4.0)
    best = int(score.argmax())
    return votes[tree.query_ball_point(votes[best], _TOGETHER_M)].mean(axis=0), float(score[best])
