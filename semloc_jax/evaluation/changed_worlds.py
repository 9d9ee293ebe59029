"""What a made map says of a world that changed while drives went by (room: evaluation; host).

In: the made map, the exact world at each drive in the order of time, who looked at each thing. Out: ChangeFigures.
Things are compared, lines are not: what of a line has changed, `compare_maps` says in metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from semloc_jax.evaluation.map_shapes import Comparable, is_line, kind_of, thing_of

SAME_M = 0.3
"""A thing that moved by less has not changed."""
NEAR_M = 0.4
"""So far a thing of the made map may lie from the true one that it is; the scale of many drives is worth half of it."""
ENOUGH_LOOKS, FEW_LOOKS = 5, 3


@dataclass(frozen=True)
class WorldThings:
    """Every thing that was ever there.

    Attributes:
        elements: one for each, as it was first.
        there: `bool[n d]` at which drive it was there.
    """

    elements: tuple[Comparable, ...]
    there: Bool[np.ndarray, "n d"]

    @classmethod
    def of(cls, worlds: Sequence[Sequence[Comparable]]) -> "WorldThings":
        """Those of the worlds of all drives, in the order of time."""
        elements: list[Comparable] = []
        rows: list[set[int]] = []
        for world in worlds:
            things = [e for e in world if not is_line(e) and e.style != "virtual"]
            row = dict(pairs_of(things, elements, SAME_M))
            for k, element in enumerate(things):
                if k not in row:
                    row[k] = len(elements)
                    elements.append(element)
            rows.append(set(row.values()))
        there = np.array([[k in row for row in rows] for k in range(len(elements))], dtype=bool)
        return cls(tuple(elements), there.reshape(len(elements), len(worlds)))


@dataclass(frozen=True)
class ChangeFigures:
    """How well a map knows what has changed, counted in things.

    Attributes:
        came, gone: for each thing that came, or went: drives that have looked since, and 1 where the map
            knows it.
        num_there: things of the last world that were there from the first drive on and that a drive looked at.
        deleted: of them, those that the map had and has told to be removed.
        num_invented: things of the map where the last world has none of their kind.
        num_old: of these, those where one was that has gone.
    """

    came: Int[np.ndarray, "came 2"]
    gone: Int[np.ndarray, "gone 2"]
    num_there: int
    deleted: int
    num_invented: int
    num_old: int

    def to_text(self, length_m: float) -> str:
        """The figures in words; the length is that of the road."""
        rows = []
        for least in (ENOUGH_LOOKS, FEW_LOOKS):
            counts = [(word, *known(table, least)) for word, table in (("gone", self.gone), ("come", self.came))]
            told = ", ".join(f"{word} {num} of {of}" for word, num, of in counts)
            rows.append(f"found of what {least} or more drives have looked at since: {told}")
        per_km = 1000.0 * self.num_invented / max(length_m, 1.0)
        rows.append(
            f"in the map and not in the world: {self.num_invented} ({per_km:.0f} per km), {self.num_old} of them were "
            f"there once; removed and still there: {self.deleted} of {self.num_there}"
        )
        return "\n".join(rows)


def known(table: Int[np.ndarray, "k 2"], least_looks: int) -> tuple[int, int]:
    """How many of what came or went (`ChangeFigures`) are known, and how many were looked at so often at least."""
    rows = table[table[:, 0] >= least_looks]
    return int(rows[:, 1].sum()), len(rows)


def change_figures(
    made: Sequence[Comparable],
    removed: Sequence[Comparable],
    worlds: WorldThings,
    looked: Bool[np.ndarray, "n d"],
    T_world_made: Float[np.ndarray, "4 4"],
) -> ChangeFigures:
    """Judges a map by what was really there.

    Args:
        made: elements of the map.
        removed: what it says has gone, as it was.
        worlds: what was there at each drive.
        looked: `[n d]` which drives looked at the places of its things.
        T_world_made: the motion in the plane that lays the map onto the world.
    """
    things = [_moved(e, T_world_made) for e in made if not is_line(e)]
    now = np.flatnonzero(worlds.there[:, -1])
    pairs = pairs_of(things, [worlds.elements[k] for k in now], NEAR_M)
    placed = {int(now[j]) for _, j in pairs}
    spare = [things[i] for i in sorted(set(range(len(things))) - {i for i, _ in pairs})]
    past = np.flatnonzero(~worlds.there[:, -1])
    old = {int(past[j]) for _, j in pairs_of(spare, [worlds.elements[k] for k in past], NEAR_M)}
    first, last = worlds.there.argmax(axis=1), worlds.there.shape[1] - 1 - worlds.there[:, ::-1].argmax(axis=1)
    since = [int(looked[k, first[k] :].sum()) for k in now if first[k]]
    came = [(num, int(k) in placed) for num, k in zip(since, (k for k in now if first[k]), strict=True)]
    gone = [(int(looked[k, last[k] + 1 :].sum()), int(k) not in old) for k in past]
    stayed = [int(k) for k in now if not first[k] and looked[k].any()]
    lost = [_moved(e, T_world_made) for e in removed if not is_line(e)]
    wrongly = {stayed[j] for _, j in pairs_of(lost, [worlds.elements[k] for k in stayed], NEAR_M)}
    return ChangeFigures(
        np.array(came, dtype=int).reshape(-1, 2),
        np.array(gone, dtype=int).reshape(-1, 2),
        len(stayed),
        len(wrongly - placed),
        len(spare),
        len(old),
    )


def pairs_of(made: Sequence[Comparable], true: Sequence[Comparable], reach_m: float) -> list[tuple[int, int]]:
    """One-to-one pairs of things of a kind with the least sum of squared distances, none farther apart."""
    found: list[tuple[int, int]] = []
    kinds = [[kind_of(e) for e in side] for side in (made, true)]
    centres = [np.array([thing_of(e).centre for e in side]).reshape(-1, 2) for side in (made, true)]
    for kind in sorted(set(kinds[0]) & set(kinds[1])):
        rows, columns = (np.array([k for k, own in enumerate(side) if own == kind]) for side in kinds)
        apart_m = np.linalg.norm(centres[0][rows][:, None] - centres[1][columns][None], axis=2)
        chosen = linear_sum_assignment(np.minimum(apart_m, reach_m) ** 2)
        near = apart_m[chosen] < reach_m
        found += zip(rows[chosen[0][near]].tolist(), columns[chosen[1][near]].tolist(), strict=True)
    return found


def _moved(element: Comparable, T: Float[np.ndarray, "4 4"]) -> Comparable:
    return replace(element, points=element.points @ T[:3, :3].T + T[:3, 3])
