"""Records of many elements as columns (room: maps; host).

In: records by row. Out: lists that pack well: like beside like, numbers as differences; and the records back.
"""

from collections.abc import Iterable, Mapping
from itertools import accumulate, pairwise

from semloc_jax.maps.versions.records import POINTS, Record

_BY = "+"
"""Begins the name of a column whose values are differences from those of the base; no column of an element does."""


def steps(numbers: Iterable[int]) -> list[int]:
    """Each number less the one before it."""
    held = [0, *numbers]
    return [b - a for a, b in pairwise(held)]


def table(rows: Mapping[int, Record]) -> list:
    """Records by their columns: numbers of the rows; for each column which rows have it (0: all) and its values."""
    names = list(dict.fromkeys(name for record in rows.values() for name in record))
    columns = []
    for name in names:
        held = [k for k, record in enumerate(rows.values()) if name in record]
        values = [record[name] for record in rows.values() if name in record]
        columns.append([name, 0 if len(held) == len(rows) else steps(held), values])
    return [steps(list(rows)), columns]


def rows_of(told: list) -> dict[int, Record]:
    """The records of such columns."""
    numbers, columns = list(accumulate(told[0])), told[1]
    found: list[Record] = [{} for _ in numbers]
    for name, held, values in columns:
        rows = range(len(numbers)) if held == 0 else list(accumulate(held))
        for k, value in zip(rows, values, strict=True):
            found[k][str(name)] = value
    return dict(zip(numbers, found, strict=True))


def against(columns: Record, old: Record) -> Record:
    """Columns with counts and coordinates as differences from those of the base, where both are whole numbers."""
    found: Record = {}
    for name, value in columns.items():
        before = old.get(name)
        if name == POINTS and before is not None and before[0] == value[0] == "mm" and len(before[1]) == len(value[1]):
            found[_BY + name] = [b - a for a, b in zip(before[1], value[1], strict=True)]
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
        if key == name:
            found[name] = value
        elif key == POINTS:
            found[key] = ["mm", [a + b for a, b in zip(old[key][1], value, strict=True)]]
        else:
            found[key] = old[key] + value
    return found
