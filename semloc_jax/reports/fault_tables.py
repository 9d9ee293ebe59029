"""Tables of faults that grow line by line, and how well a localizer knows its errors in them (room: reports; host).

In: rows, a dataclass; faults_frames.csv. Out: a csv file and its rows; stanford.png, reliability.csv, a sentence.
"""

import csv
import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np
from scipy.special import ndtri

from semloc_jax import viz
from semloc_jax.evaluation.metrics import ALERT_LIMITS
from semloc_jax.reports.tables import write_csv
from semloc_jax.storage import reading
from semloc_jax.viz.tracking import IntegrityErrors, stanford_diagram

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
            raise ValueError("columns are not those of this version; start again with another --out")
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


_STATED = (0.68, 0.95, 0.997)
_NAMES = (("lateral", "m"), ("longitudinal", "m"), ("heading", "deg"))


def write_figures(folder: Path) -> str:
    """Draw the Stanford diagram of all frames under faults that something can see, and count who lies in which bound.

    Returns:
        The shares of errors within the stated 68, 95 and 99.7 % bounds, of frames called TRACKING.
    """
    errors, levels, sigmas, is_tracking = _read(folder / "faults_frames.csv")
    if not len(errors):
        return ""
    limit = ALERT_LIMITS[0]
    limits = (limit.lateral_m, limit.longitudinal_m, limit.heading_deg)
    offered = np.where(is_tracking[:, None], levels, np.inf)
    directions = {
        name: IntegrityErrors(errors[:, k], offered[:, k], limits[k], unit) for k, (name, unit) in enumerate(_NAMES)
    }
    viz.save(stanford_diagram(directions), folder / "stanford.png")
    rows = reliability(errors[is_tracking], sigmas[is_tracking])
    write_csv(folder / "reliability.csv", ("stated", *(name for name, _ in _NAMES)), rows)
    told = "; ".join(
        f"{name} {' / '.join(f'{100 * row[1 + k]:.1f}' for row in rows)}" for k, (name, _) in enumerate(_NAMES)
    )
    return f"errors of TRACKING frames within their stated 68 / 95 / 99.7 % bounds [%]: {told}"


def reliability(errors: np.ndarray, sigmas: np.ndarray) -> list[tuple[float, ...]]:
    """The stated probability and the share of errors within its bound, for each column.

    Args:
        errors: `[n k]`, absolute.
        sigmas: `[n k]`, as stated.
    """
    found = []
    for stated in _STATED:
        inside = errors <= ndtri(0.5 + 0.5 * stated) * sigmas
        found.append(
            (stated, *(float(share) for share in inside.mean(axis=0))) if len(errors) else (stated, *[np.nan] * 3)
        )
    return found


def _read(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Errors, levels, sigmas [n 3] and who was TRACKING [n], of the rows that count."""
    from semloc_jax.simulation.hostile import suite  # a run without faults does without the 50 modules of a simulation

    apart = {row.fault for row in suite() if row.apart}
    with reading(f"table {path}"), path.open(newline="", encoding="utf-8") as file:
        lines = [line for line in list(csv.reader(file))[1:] if line[0] not in apart]
        table = np.array([[float(cell) for cell in line[3:]] for line in lines]).reshape(-1, 10)
    return table[:, 1:4], table[:, 4:7], table[:, 7:10], table[:, 0] > 0.0
