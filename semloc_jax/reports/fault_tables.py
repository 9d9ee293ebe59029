"""Tables that grow line by line and are read back after a kill (room: reports; host).

In: rows, a dataclass. Out: a csv file; its rows.
"""

import csv
import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from semloc_jax.reports.tables import write_csv
from semloc_jax.storage import reading

TABLE = "faults.csv"
Row = TypeVar("Row")


def append(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Add rows at the end of a table, which begins with its columns."""
    is_new = not path.is_file()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow(columns)
        writer.writerows(rows)


def read_outcomes(path: Path, kind: type[Row]) -> list[Row]:
    """The lines of a faults.csv; none where there is no file; a last line that a kill has cut is left out.

    Raises:
        SemlocError: the file is not a table of such rows.
    """
    if not path.is_file():
        return []
    types = get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind)]
    with reading(f"table {path}"), path.open(newline="", encoding="utf-8") as file:
        lines = list(csv.reader(file))
        if not lines or lines[0] != names:
            raise ValueError("columns are not those of this version; begin anew with another --out")
        whole = [line for line in lines[1:] if len(line) == len(names)]
        return [kind(*(types[n](cell) for n, cell in zip(names, line, strict=True))) for line in whole]


def taken_up(path: Path, kind: type[Row]) -> list[Row]:
    """The lines of a table that goes on: a last one that a kill has cut is taken out of the file, too.

    Raises:
        SemlocError: the file is not a table of such rows.
    """
    found = read_outcomes(path, kind)
    if path.is_file():
        names = [field.name for field in dataclasses.fields(kind)]
        write_csv(path, names, [dataclasses.astuple(row) for row in found])
    return found
