"""Comma-separated sensor logs with named columns (room: datasets; host).

In: a csv file. Out: float64 columns by name.
"""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from semloc_jax.errors import SemlocError


def read_rows(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Rows of a csv file with a header line, as text.

    Raises:
        SemlocError: the file is missing or lacks one of `columns`.
    """
    if not path.is_file():
        raise SemlocError(f"table {path}: no such file; expected a csv with columns {', '.join(columns)}")
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        header = reader.fieldnames or []
        missing = [column for column in columns if column not in header]
        if missing:
            raise SemlocError(
                f"table {path}: has columns {', '.join(header)}; expected also {', '.join(missing)}; rename or add them"
            )
        return list(reader)


def read_columns(path: Path, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns of a csv file as float64 [n], an empty cell as nan.

    Raises:
        SemlocError: the file is missing, lacks a column or holds text where a number is expected.
    """
    rows = read_rows(path, columns)
    found = {}
    for column in columns:
        try:
            found[column] = np.array([float(row[column] or "nan") for row in rows])
        except ValueError as error:
            raise SemlocError(f"table {path}: column '{column}': {error}; expected numbers") from error
    return found
