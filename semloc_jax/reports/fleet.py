"""Many drives at once: what `semloc localize` and `semloc track` do with several (room: reports; host).

In: drives, what to do with one. Out: a folder for each drive, fleet.csv, a table. The results of a drive are those of a
run of its own.
"""

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from semloc_jax.errors import SemlocError
from semloc_jax.reports.folder import make_folder
from semloc_jax.reports.run_inputs import FILE as BEGUN
from semloc_jax.reports.tables import write_csv
from semloc_jax.runtime.crew import spread

TABLE, TEXT = "fleet.csv", "console.txt"
DONE, FAILED, LOST = "done", "failed", "lost"


class FleetPlace(NamedTuple):
    """Where the results of one drive go."""

    drive: Path
    out: Path
    is_begun: bool
    """Whether a run of it was killed there, to go on with."""


class FleetRow(NamedTuple):
    """How one drive went."""

    drive: str
    result: str
    """done, lost (below its share of good frames) or failed."""
    num_frames: int
    cpu_s: float
    """Of the process, with what it compiled where the drive was its first."""
    why: str = ""

    @property
    def frames_per_core_hour(self) -> float:
        """Frames that one core does in an hour."""
        return 3600.0 * self.num_frames / self.cpu_s if self.cpu_s > 0 else 0.0


@dataclass(frozen=True)
class FleetReport:
    """How all drives went."""

    folder: Path
    rows: list[FleetRow]

    @property
    def text(self) -> str:
        """The table, and all drives in one line."""
        width = max(len(row.drive) for row in self.rows)
        head = f"{'drive':<{width}}  {'result':<6} {'frames':>6} {'CPU s':>8} {'frames / core h':>15}"
        total = FleetRow("all", "", sum(row.num_frames for row in self.rows), sum(row.cpu_s for row in self.rows))
        lines = [
            f"{row.drive:<{width}}  {row.result:<6} {row.num_frames:>6} {row.cpu_s:>8.1f} "
            f"{row.frames_per_core_hour:>15.0f}  {row.why}".rstrip()
            for row in (*self.rows, total)
        ]
        return "\n".join([head, *lines])

    def has(self, result: str) -> bool:
        """Whether any drive went so."""
        return any(row.result == result for row in self.rows)


def report_fleet(
    work: Callable[[FleetPlace], FleetRow],
    drives: Sequence[Path],
    out: Path | None = None,
    resume: Path | None = None,
    jobs: int = 1,
    on_ray: bool = False,
) -> FleetReport:
    """Do the same with every drive, in processes of their own, and write a table of all.

    Args:
        work: What is done with one drive; it is sent to the processes. What it raises ends the fleet.
        drives: Their names tell their folders apart.
        jobs: Processes; 1 works in this one.
        on_ray: On a Ray cluster instead.

    Raises:
        SemlocError: two drives have the same name.
    """
    names = [drive.resolve().stem if drive.is_file() else drive.resolve().name for drive in drives]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise SemlocError(
            f"{len(drives)} drives: several are called {', '.join(twice)}; give their folders other names"
        )
    folder = make_folder(out, resume)
    rows = {row.drive: row for row in _read(folder / TABLE) if row.result != FAILED} if resume is not None else {}
    places = {
        name: FleetPlace(drive, folder / name, resume is not None and (folder / name / BEGUN).is_file())
        for name, drive in zip(names, drives, strict=True)
    }
    left = [(name, place) for name, place in places.items() if name not in rows]
    with tqdm(total=len(drives), initial=len(drives) - len(left), unit="drive", disable=None) as bar:
        for name, row in spread(work, left, min(jobs, max(len(left), 1)), on_ray):
            rows[name] = row._replace(drive=name)
            write_csv(folder / TABLE, FleetRow._fields, rows.values())
            bar.update()
    return FleetReport(folder, [rows[name] for name in names])


def num_frames(folder: Path) -> int:
    """Frames in the table of a run."""
    path = folder / "frames.csv"
    if not path.is_file():
        return 0
    with path.open(newline="", encoding="utf-8") as file:
        return sum(1 for _ in csv.DictReader(file))


def _read(path: Path) -> list[FleetRow]:
    if not path.is_file():
        return []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            read = partial(_row, path)
            return [read(row) for row in csv.DictReader(file)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise _not_ours(path) from error


def _row(path: Path, row: dict[str, str]) -> FleetRow:
    try:
        return FleetRow(row["drive"], row["result"], int(row["num_frames"]), float(row["cpu_s"]), row["why"])
    except (KeyError, TypeError, ValueError) as error:
        raise _not_ours(path) from error


def _not_ours(path: Path) -> SemlocError:
    return SemlocError(
        f"{path}: expected the columns {', '.join(FleetRow._fields)} of 'semloc localize' or 'track' with several "
        "drives; give the folder of such a run, or start again with another --out"
    )
