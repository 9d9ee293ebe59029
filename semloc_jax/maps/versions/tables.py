"""Records of many elements as columns (room: maps; host).

In: records by row. Out: lists that pack well: like beside like, numbers as differences; and the records back.
"""

from collections.abc import Mapping
from itertools import accumulate

import numpy as np

from semloc_jax.maps.versions.datum import steps
from semloc_jax.maps.versions.records import KEYS, POINTS, Record, whole_mm

_BY = "+"
"""Begins the name of a column whose values are differences from those of the base; no column of an element does."""
_SPLICED = "~" + POINTS
"""A line of which a part is another: how many points of the base stay before it and after it, and the part."""
_ALL = "all"
"""Stands for a value that all rows of a column have."""


def table(rows: Mapping[int, Record]) -> list:
    """Records by their columns: numbers of the rows; for each column which rows have it (0: all) and its values.

    A value that all of these have is told once, as `{"all": value}`.
    """
    names = list(dict.fromkeys(name for record in rows.values() for name in record))
    columns = []
    for name in names:
        held = [k for k, record in enumerate(rows.values()) if name in record]
        values = [record[name] for record in rows.values() if name in record]
        is_one = len(values) > 1 and all(repr(value) == repr(values[0]) for value in values)
        which = 0 if len(held) == len(rows) else steps(held)
        columns.append([name, which, {_ALL: values[0]} if is_one else values])
    return [steps(list(rows)), columns]


def rows_of(told: list) -> dict[int, Record]:
    """The records of such columns."""
    numbers, columns = list(accumulate(told[0])), told[1]
    found: list[Record] = [{} for _ in numbers]
    for name, held, values in columns:
        rows = list(range(len(numbers)) if held == 0 else accumulate(held))
        each = [values[_ALL]] * len(rows) if isinstance(values, dict) else values
        for k, value in zip(rows, each, strict=True):
            found[k][str(name)] = value
    return dict(zip(numbers, found, strict=True))


def against(columns: Record, old: Record) -> Record:
    """Columns with counts and coordinates as differences from those of the base, where they are whole numbers."""
    found: Record = {}
    for name, value in columns.items():
        before = old.get(name)
        if name == POINTS and before is not None and value[0] == before[0] == "mm" and len(value[1]) != len(before[1]):
            found[_SPLICED] = _spliced(before[1], value[1])
        elif name == POINTS and before is not None and value[0] == "mm":
            found[_BY + name] = [b - a for a, b in zip(_near(old, len(value[1])), value[1], strict=True)]
        elif name == KEYS and before is not None and value[: len(before)] == before:
            found[_BY + name] = value[len(before) :]
        elif type(value) is int and type(before) is int:
            found[_BY + name] = value - before
        else:
            found[name] = value
    return found


def upon(columns: Record, old: Record) -> Record:
    """The columns that `against` told."""
    found: Record = {}
    for name, value in columns.items():
        key = name.removeprefix(_BY)
        if name == _SPLICED:
            found[POINTS] = ["mm", _joined(old[POINTS][1], value)]
        elif key == name:
            found[name] = value
        elif key == POINTS:
            found[key] = ["mm", [a + b for a, b in zip(_near(old, len(value)), value, strict=True)]]
        else:
            found[key] = old[key] + value
    return found


def _near(old: Record, num: int) -> list[int]:
    """What so many coordinates are told against: those of the base, or its first point where it has another number."""
    before = whole_mm(old)
    return before if len(before) == num else [*before[:3], *[0] * (num - 3)]


def _spliced(before: list[int], now: list[int]) -> list[int]:
    """Numbers of points that stay at both ends, and the points between, each less the one before it."""
    old, new = (np.cumsum(np.array(side, dtype=np.int64).reshape(-1, 3), axis=0) for side in (before, now))
    most = min(len(old), len(new))
    head = next((k for k in range(most) if (old[k] != new[k]).any()), most)
    tail = next((k for k in range(most - head) if (old[-1 - k] != new[-1 - k]).any()), most - head)
    start = old[max(head - 1, 0)][None]
    return [head, tail, *np.diff(np.vstack([start, new[head : len(new) - tail]]), axis=0).ravel().tolist()]


def _joined(before: list[int], told: list[int]) -> list[int]:
    """The points that `_spliced` told, each less the one before it.

    Raises:
        ValueError: more points stay than there are.
    """
    old = np.cumsum(np.array(before, dtype=np.int64).reshape(-1, 3), axis=0)
    head, tail = told[:2]
    if min(head, tail) < 0 or head + tail > len(old):
        raise ValueError("points of a line that are not there")
    part = old[max(head - 1, 0)] + np.cumsum(np.array(told[2:], dtype=np.int64).reshape(-1, 3), axis=0)
    points = np.vstack([old[:head], part, old[len(old) - tail :]])
    return np.diff(points, axis=0, prepend=0).ravel().tolist()
