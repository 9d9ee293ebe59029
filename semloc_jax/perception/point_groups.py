"""Sums and medians over many groups of points at once (room: perception; host).

In: the sizes of the groups, whose points follow each other in arrays. Out: one value for each group.
"""

from collections.abc import Sequence

import numpy as np


class PointGroups:
    """Groups of points that follow each other in arrays [n ...]; those summed or searched for extremes have points.

    Args:
        sizes: points of each group.
    """

    def __init__(self, sizes: Sequence[int] | np.ndarray) -> None:
        self.sizes = np.asarray(sizes, int)
        self.number = np.repeat(np.arange(len(self.sizes)), self.sizes)
        """Group of each point, int[n]."""
        self.start = np.cumsum(self.sizes) - self.sizes
        """First point of each group, int[groups]."""

    def __len__(self) -> int:
        return len(self.sizes)

    @property
    def rank(self) -> np.ndarray:
        """Place of each point in its group, from 0, int[n]."""
        return np.arange(len(self.number)) - self.start[self.number]

    @property
    def slices(self) -> list[slice]:
        """Where the points of each group lie."""
        ends = self.start + self.sizes
        return [slice(*part) for part in zip(self.start.tolist(), ends.tolist(), strict=True)]

    def total(self, values: np.ndarray) -> np.ndarray:
        """Sum over each group, [groups ...]."""
        return np.add.reduceat(values, self.start, axis=0)

    def least(self, values: np.ndarray) -> np.ndarray:
        """Least value of each group."""
        return np.minimum.reduceat(values, self.start)

    def most(self, values: np.ndarray) -> np.ndarray:
        """Largest value of each group."""
        return np.maximum.reduceat(values, self.start)

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean over each group, float[groups ...]."""
        return (self.total(values).T / self.sizes).T

    def median(self, values: np.ndarray, among: np.ndarray) -> np.ndarray:
        """Median of each group over some of its points, infinite for a group without any.

        Args:
            values: float[n].
            among: the points that count, bool[n].
        """
        groups = PointGroups(np.bincount(self.number[among], minlength=len(self)))
        ordered = np.append(groups._sorted(values[among]), np.asarray(np.inf, values.dtype))
        middle = 0.5 * (ordered[groups.start + (groups.sizes - 1) // 2] + ordered[groups.start + groups.sizes // 2])
        return np.where(groups.sizes > 0, middle, np.inf)

    def quantiles(self, values: np.ndarray, *shares: float) -> np.ndarray:
        """Values below which shares of each group lie, in proportion between neighbours, float[shares groups]."""
        ordered = self._sorted(values)
        place = np.multiply.outer(shares, self.sizes - 1)
        before = place.astype(int)
        low, high = (ordered[self.start + np.minimum(at, self.sizes - 1)] for at in (before, before + 1))
        return low + (place - before) * (high - low)

    def _sorted(self, values: np.ndarray) -> np.ndarray:
        """The values of each group in order."""
        ordered = values.copy()
        for part in self.slices:
            ordered[part].sort()
        return ordered


def extremes(values: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest value of the points of each number, in any order; each number from 0 on has points."""
    groups = PointGroups(np.bincount(number))
    ordered = values[np.argsort(number, kind="stable")]
    return groups.least(ordered), groups.most(ordered)
