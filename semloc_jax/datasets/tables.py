"""Sensor logs in text with named columns (room: datasets; host).

In: a csv file, separated by commas, semicolons or tabs. Out: float64 columns by name.
"""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from semloc_jax.errors import SemlocError

_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*")


def read_rows(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Rows of a csv file with a header line, as text; numbers such as 48,07 between semicolons get a decimal point.

    Raises:
        SemlocError: the file is missing or lacks one of `columns`.
    """
    if not path.is_file():
        raise SemlocError(f"table {path}: no such file; expected a csv with columns {', '.join(columns)}")
    try:
        with path.open(newline="", errors="replace") as file:
            separator = _separator(file.readline())
            file.seek(0)
            reader = csv.DictReader(file, delimiter=separator)
            header = reader.fieldnames or []
            # Cells beyond the header have no name, and those that a short row lacks are empty.
            rows = [{key: cell or "" for key, cell in row.items() if key is not None} for row in reader]
    except csv.Error as error:
        raise SemlocError(f"table {path}: {error}; expected comma-separated rows") from error
    missing = [column for column in columns if column not in header]
    if missing:
        raise SemlocError(
            f"table {path}: has columns {', '.join(header)}; expected also {', '.join(missing)}; rename or add them"
        )
    return [_with_points(row) for row in rows] if separator == ";" else rows


def _separator(header: str) -> str:
    """What stands between the names of a header: a comma, else a semicolon or a tab where there is none."""
    return next((mark for mark in (",", ";", "\t") if mark in header), ",")


def _with_points(row: dict[str, str]) -> dict[str, str]:
    return {key: cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for key, cell in row.items()}


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


def read_cells(path: Path, columns: int) -> list[list[str]]:
    """Rows of a csv file without a header or after one, as text; lines that begin with # are left out.

    Raises:
        SemlocError: the file is missing, holds no row, or a row has fewer than `columns` cells.
    """
    if not path.is_file():
        raise SemlocError(f"table {path}: no such file; expected rows of {columns} cells")
    lines = [line for line in path.read_text(errors="replace").splitlines() if line.strip() and line.lstrip()[0] != "#"]
    try:
        rows = list(csv.reader(lines))
    except csv.Error as error:
        raise SemlocError(f"table {path}: {error}; expected comma-separated rows") from error
    if not rows:
        raise SemlocError(f"table {path}: holds no row; expected rows of {columns} cells")
    short = next((number for number, row in enumerate(rows) if len(row) < columns), None)
    if short is not None:
        raise SemlocError(f"table {path}: row {short + 1} has {len(rows[short])} cells; expected {columns}")
    return rows


def read_numbers(path: Path, columns: int | None) -> np.ndarray:
    """Numbers of a text file [n columns], separated by blanks or commas; lines after # are left out.

    Raises:
        SemlocError: the file is missing, holds text, or its rows differ in length.
    """
    if not path.is_file():
        raise SemlocError(f"table {path}: no such file; expected rows of numbers")
    lines = [line.split("#", 1)[0].replace(",", " ").split() for line in path.read_text(errors="replace").splitlines()]
    lines = [line for line in lines if line]
    try:
        table = np.array(lines, dtype=np.float64)
    except ValueError as error:
        raise SemlocError(f"table {path}: {str(error)[:120]}; expected rows of numbers of one length") from error
    if table.ndim != 2 or (columns is not None and table.shape[1] != columns):
        shape = f"{table.shape[1]} columns" if table.ndim == 2 else "nothing"
        raise SemlocError(f"table {path}: holds {shape}; expected {columns or 'rows'} of numbers")
    return table


def find_columns(path: Path, wanted: dict[str, Sequence[str]], optional: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Columns of a csv file by meaning, under any of the names that people give them.

    Args:
        path: csv file with a header.
        wanted: names of each meaning, e.g. {"lat": ("lat", "latitude")}; case and surrounding blanks do not matter.
        optional: meanings that may be absent.

    Returns:
        float64[n] by meaning.

    Raises:
        SemlocError: a column is missing or holds text.
    """
    names = column_names(path, wanted)
    missing = [meaning for meaning in wanted if meaning not in names and meaning not in optional]
    if missing:
        tried = "; ".join(f"{meaning}: {', '.join(wanted[meaning])}" for meaning in missing)
        raise SemlocError(f"table {path}: no column for {', '.join(missing)}; expected one of these names ({tried})")
    table = read_columns(path, list(names.values()))
    return {meaning: table[column] for meaning, column in names.items()}


def column_names(path: Path, wanted: dict[str, Sequence[str]]) -> dict[str, str]:
    """The column of a csv file for each meaning that it has."""
    header = list(read_rows(path, ())[:1])
    columns = [name for name in (header[0] if header else ()) if isinstance(name, str)]
    spelled = {column.strip().lower(): column for column in columns}
    return {meaning: spelled[name] for meaning, names in wanted.items() for name in names[::-1] if name in spelled}
