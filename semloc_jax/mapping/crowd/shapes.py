"""Where each thing of a world lies, how it is turned and how large it is (room: mapping; host).

In: Fused. Out: Shapes; under a survey by the first of its sights alone, so that not every drive rewrites everything.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.mapping.crowd.fragments import FRAGMENTED
from semloc_jax.mapping.crowd.fusion import Fused
from semloc_jax.mapping.crowd.world import turned_by

_FIRST, _MORE = 2, 4
"""What is new to a survey is told by its first sights, and again once so many times as many have seen it; ours."""

_ALIKE, _SAME_HALF_M = 3, 0.1
"""So many drives that have a short thing as long as each other, to twice this, have seen all of it; ours."""


class Shapes(NamedTuple):
    """Things from above."""

    centre: Float[np.ndarray, "n 2"]
    along: Float[np.ndarray, "n 2"]
    half_m: Float[np.ndarray, "n 2"]
    """Half the length and half the width."""


def shapes_of(found: Fused) -> Shapes:
    """The mean direction and median size of what drives saw; under a survey the mean place too, else that of all."""
    counted = counted_sights(found)
    along, half_m = _directions(found, counted)
    if not found.is_surveyed:
        return Shapes(found.world.centre, along, half_m)
    weight, total = np.zeros(len(found.world.kind)), np.zeros((len(found.world.kind), 2))
    for drive, seen, own in zip(found.drives, found.seen, counted, strict=True):
        i, j = seen.pairs[own].T
        things, ahead, seen_at = drive.sights.things, found.world.along[j], drive.moved_things()[i]
        # The middle of a part says nothing along the thing.
        past_m = np.where(things.has_ends[i], 0.0, ((seen_at - found.world.centre[j]) * ahead).sum(axis=1))
        sure = 1.0 / np.square(things.sigma_m[i]).sum(axis=1)
        np.add.at(weight, j, sure)
        np.add.at(total, j, sure[:, None] * (seen_at - past_m[:, None] * ahead))
    mean = total / np.maximum(weight, 1e-12)[:, None]
    return Shapes(np.where(weight[:, None] > 0.0, mean, found.world.centre), along, half_m)


def are_placed(found: Fused) -> Bool[np.ndarray, " n"]:
    """Which things lie where they are drawn: of dashes and bars that no drive has seen whole only a part is known.

    What is shorter than those around it is whole all the same where several drives show both of its ends alike: traffic
    and dirt cut off now more, now less.
    """
    world = found.world
    placed = ~np.isin(world.kind.astype(str), FRAGMENTED) | _are_short(found)
    for k, (drive, seen) in enumerate(zip(found.drives, found.seen, strict=True)):
        i, j = seen.pairs.T
        if k not in found.distrusted:
            placed[j[drive.sights.things.has_ends[i] | drive.sights.is_base]] = True
    return placed


def _are_short(found: Fused) -> Bool[np.ndarray, " n"]:
    """Which things several drives show with two clear ends and as long as each other."""
    halves: list[list[float]] = [[] for _ in found.world.kind]
    for k, (drive, seen) in enumerate(zip(found.drives, found.seen, strict=True)):
        things = drive.sights.things
        for i, j in seen.pairs.tolist() if k not in found.distrusted else []:
            if all(things.elements[i].true_ends):
                halves[j].append(float(things.half_m[i, 0]))
    alike = [sum(abs(half - np.median(own)) < _SAME_HALF_M for half in own) for own in halves]
    return np.array([num >= _ALIKE for num in alike], dtype=bool)


def counted_sights(found: Fused) -> list[np.ndarray]:
    """Which pairs of each drive `bool[k]` say where a thing lies: under a survey the first of each, else all."""
    trusted = [np.full(len(seen.pairs), k not in found.distrusted) for k, seen in enumerate(found.seen)]
    if not found.is_surveyed:
        return trusted
    trusted[0][:] = False
    total, before = (np.zeros(len(found.world.kind), dtype=np.int64) for _ in range(2))
    for seen, own in zip(found.seen, trusted, strict=True):
        total[seen.pairs[own, 1]] += 1
    told = np.maximum(told_number(total), np.minimum(total, 1))
    for seen, own in zip(found.seen, trusted, strict=True):
        j = seen.pairs[own, 1]
        own[own] = before[j] < told[j]
        before[j] += 1
    return trusted


def told_number(num: np.ndarray) -> np.ndarray:
    """The largest of 0, 2, 8, 32 ... that is no more than a number."""
    steps = np.floor(np.log(np.maximum(num, _FIRST) / _FIRST) / np.log(_MORE) + 1e-9)
    return np.where(num < _FIRST, 0, (_FIRST * _MORE**steps).astype(np.int64))


def _directions(found: Fused, counted: list[np.ndarray]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Direction of each thing, the mean of all that saw it, and its half length and width, the median."""
    world = found.world
    doubled = np.zeros(len(world.kind), dtype=complex)
    sizes: list[list[np.ndarray]] = [[] for _ in range(len(world.kind))]
    for drive, seen, own in zip(found.drives, found.seen, counted, strict=True):
        things = drive.sights.things
        i, j = seen.pairs[own].T
        along = turned_by(things.along[i], drive.turn(things.centre[i]))
        np.add.at(doubled, j, (along[:, 0] + 1j * along[:, 1]) ** 2)
        for a, b in zip(i, j, strict=True):
            if things.has_ends[a]:
                sizes[b].append(things.half_m[a])
    angle = 0.5 * np.angle(doubled)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along *= np.where((along * world.along).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    along[np.abs(doubled) < 1e-9] = world.along[np.abs(doubled) < 1e-9]
    half = [np.median(own, axis=0) if own else world.half_m[k] for k, own in enumerate(sizes)]
    return along, np.array(half).reshape(-1, 2)
