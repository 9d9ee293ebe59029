"""Whole numbers as differences, which pack well (room: maps; host).

In: numbers. Out: each less the one before it; `itertools.accumulate` gives them back.
"""

from collections.abc import Iterable
from itertools import pairwise


def steps(numbers: Iterable[int]) -> list[int]:
    """Each number less the one before it."""
    held = [0, *numbers]
    return [b - a for a, b in pairwise(held)]
