"""How the frame of a map has moved since its elements were published (room: maps; host).

In: shifts at the nodes of a grid, points. Out: points moved by it, and back without the loss of a bit.
More drives tell better where a road lies: the whole map moves a little and bends. Told element by element that were a
new map; told once, for all of them, it is a few numbers. Elements keep the coordinates that they were published with,
whole `CELL_MM`; where they lie by now follows in whole numbers, alike on every machine.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np
from jaxtyping import Float, Int

CELL_MM = 5
"""Published coordinates are multiples: far enough apart that a small bend never brings two of them together."""
NODE_MM = 64_000
"""Step of the grid; ours: what many drives are off alike is smooth over so much."""
_MOST_MM = 10**7
_MOST_NODE = 10**6
_MOST_POINT_MM = 2**40
_ROUNDS = 4
_MM = 1000.0
_CORNERS = ((0, 0), (1, 0), (0, 1), (1, 1))


@dataclass(frozen=True)
class Datum:
    """Shifts of a map.

    Attributes:
        shifts_mm: by node, column and row of the grid: x, y and z in whole millimetres. Between nodes they are weighted
            by nearness, a node that is not named does not move.
    """

    shifts_mm: Mapping[tuple[int, int], tuple[int, int, int]]

    def __post_init__(self) -> None:
        largest = max((abs(v) for shift in self.shifts_mm.values() for v in shift), default=0)
        farthest = max((abs(v) for node in self.shifts_mm for v in node), default=0)
        if largest > _MOST_MM or farthest > _MOST_NODE:
            raise ValueError(f"a frame that moved by {largest / _MM:.0f} m at node {farthest}")

    @property
    def is_still(self) -> bool:
        """Whether it moves nothing at all."""
        return not self.shifts_mm

    @cached_property
    def _table(self) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, "k 3"]]:
        nodes = sorted(self.shifts_mm, key=lambda node: _keys(np.array([node]))[0])
        shifts = np.array([self.shifts_mm[node] for node in nodes], dtype=np.int64).reshape(-1, 3)
        return _keys(np.array(nodes, dtype=np.int64).reshape(-1, 2)), shifts

    def shift_mm(self, points_mm: Int[np.ndarray, "n 3"]) -> Int[np.ndarray, "n 3"]:
        """By how much published points have moved, the nearest whole millimetre."""
        keys, shifts = self._table
        if not len(keys):
            return np.zeros_like(points_mm)
        low = points_mm[:, :2] // NODE_MM
        share = points_mm[:, :2] - low * NODE_MM
        total = np.zeros((len(points_mm), 3), dtype=np.int64)
        for corner in _CORNERS:
            own = _keys(low + np.array(corner))
            row = np.minimum(np.searchsorted(keys, own), len(keys) - 1)
            weight = np.where(np.array(corner) == 1, share, NODE_MM - share).prod(axis=1) * (keys[row] == own)
            total += weight[:, None] * shifts[row]
        return (total + NODE_MM**2 // 2) // NODE_MM**2

    def moved(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Where points lie by now [m] that were published in whole millimetres."""
        cells = np.rint(points * _MM).astype(np.int64)
        return (cells + self.shift_mm(cells)) / _MM

    def back(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"] | None:
        """The published points that lie there by now [m]; None where there are none that give every bit of them."""
        if not np.isfinite(points).all() or np.abs(points).max(initial=0.0) * _MM > _MOST_POINT_MM:
            return None
        now = np.rint(points * _MM).astype(np.int64)
        published = now
        for _ in range(_ROUNDS):
            published = CELL_MM * np.rint((now - self.shift_mm(published)) / CELL_MM).astype(np.int64)
        found = published / _MM
        return found if self.moved(found).tobytes() == np.ascontiguousarray(points).tobytes() else None

    def to_json(self) -> list[list[int]]:
        """What a file keeps: columns of the nodes, rows, shifts in x, y and z."""
        nodes = sorted(self.shifts_mm)
        return [[*column] for column in zip(*((*node, *self.shifts_mm[node]) for node in nodes), strict=True)]

    @classmethod
    def from_json(cls, columns: list[list[int]]) -> "Datum":
        """The datum that a file keeps.

        Raises:
            TypeError, ValueError: no such columns.
        """
        if not columns:
            return cls({})
        if any(type(v) is not int for column in columns for v in column):
            raise ValueError("shifts of a frame that are no whole numbers")
        column, row, x, y, z = columns
        return cls({(a, b): (c, d, e) for a, b, c, d, e in zip(column, row, x, y, z, strict=True)})

    def against(self, before: "Datum") -> list:
        """What makes it out of the one before: columns and rows of its nodes, 0 and 0 where they are the same; how much
        shifts differ, axis after axis, each less that of the node before it."""
        nodes = sorted(self.shifts_mm)
        alike = nodes == sorted(before.shifts_mm)
        none = (0, 0, 0)
        more = [[a - b for a, b in zip(self.shifts_mm[n], before.shifts_mm.get(n, none), strict=True)] for n in nodes]
        at = [0, 0] if alike else [steps(column for column, _ in nodes), steps(row for _, row in nodes)]
        return [*at, [value for axis in zip(*more, strict=True) for value in steps(axis)]]

    @classmethod
    def upon(cls, told: list, before: "Datum") -> "Datum":
        """The datum that `against` told.

        Raises:
            TypeError, ValueError: nothing that it tells.
        """
        columns, rows, more = told
        nodes = (
            sorted(before.shifts_mm) if columns == 0 else list(zip(accumulate(columns), accumulate(rows), strict=True))
        )
        if len(more) != 3 * len(nodes):
            raise ValueError("a frame with other shifts than nodes")
        axes = [list(accumulate(more[k * len(nodes) : (k + 1) * len(nodes)])) for k in range(3)]
        found = {}
        for node, *shift in zip(nodes, *axes, strict=True):
            x, y, z = (int(a) + b for a, b in zip(shift, before.shifts_mm.get(node, (0, 0, 0)), strict=True))
            found[node] = (x, y, z)
        return cls(found)


STILL = Datum({})
"""That of a map that never moved."""


def _keys(nodes: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
    """One number for each node."""
    return nodes[:, 0] * (4 * _MOST_NODE) + nodes[:, 1]


def steps(numbers: Iterable[int]) -> list[int]:
    """Each number less the one before it; `itertools.accumulate` gives them back."""
    held = [0, *numbers]
    return [b - a for a, b in pairwise(held)]
