"""`semloc merge`: one map of many drives (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import OK


@dataclass(frozen=True)
class Options:
    """Merge packed drives into a map: each is placed in it, what it saw is fused with what all others saw; elements
    that are gone are removed, new ones are added. Elements keep their ids, also where they moved by less than a metre.

    Writes the map (.gpkg) and its history beside it (OUT.history: steps back, drives); with --report also changes.csv,
    drives.csv, metrics.json and pictures. The result depends on the set of all drives that were ever merged, not on
    their order or grouping; a drive that is in the map already changes nothing. In time, drives are ordered by date,
    those without a date by name. A drive that disagrees with all others is named and counts for little.
    """

    maps: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="[BASE] LOCAL...")]
    """The map before (any format; none: the drives make the first one) and files of 'semloc pack' (.slocal)."""
    out: Path
    """The .gpkg file to write; may be BASE itself."""
    inbox: bool = False
    """Merge what cars have uploaded to 'semloc serve BASE', too; what was merged leaves the inbox."""
    report: Path | None = None
    """A folder for tables and pictures."""
    truth: Path | None = None
    """A reference map, to judge the result by, with the rule 'replace within 5 m if more confident' beside it."""
    worlds: Path | None = None
    """With --truth: the folder of the simulated drives; WORLDS/NAME/map.geojson is the exact world of drive NAME. Says
    which share of the changes is found after how many looks, and how many elements were added or removed wrongly."""
    jobs: int = 1
    """Processes that merge cells of 1024 m at the same time; the map is the same for any number."""
    ray: bool = False
    """On a Ray cluster (RAY_ADDRESS, else one on this machine) instead of processes; needs the extra [ray]."""
    curve: bool = False
    """With --report and --truth: merge 1, 2, 4 ... of the drives too, and draw how the error falls (error.png)."""


def run(options: Options) -> int:
    """Merge, say what came out."""
    from semloc_jax.errors import UsageError
    from semloc_jax.mapping.crowd.ledger import waiting_drives
    from semloc_jax.mapping.crowd.whole import Crew
    from semloc_jax.reports.crowd import Judge, report_merged
    from semloc_jax.runtime.crew import require_ray

    packed = [path for path in options.maps if path.suffix.lower() == ".slocal"]
    bases = [path for path in options.maps if path.suffix.lower() != ".slocal"]
    if len(bases) > 1 or (bases and options.maps[0] != bases[0]):
        raise UsageError("expected at most one base map, before the drives (.slocal)")
    if options.curve and (options.report is None or options.truth is None):
        raise UsageError("--curve needs --report and --truth")
    if options.worlds is not None and options.truth is None:
        raise UsageError("--worlds needs --truth")
    if options.inbox and not bases:
        raise UsageError("--inbox needs the map that is served as BASE")
    if not packed and not options.inbox:
        raise UsageError("no drives: give files of 'semloc pack' (.slocal), or --inbox")
    if options.jobs < 1:
        raise UsageError(f"--jobs {options.jobs}: expected 1 or more")
    if options.ray:
        require_ray()
    base = bases[0] if bases else None
    waiting = waiting_drives(base) if base is not None and options.inbox else []
    if not packed and not waiting:
        print("no drive waits in the inbox; nothing changes")
        return OK
    crew = Crew(options.jobs, options.ray)
    drives = [*packed, *waiting]
    judge = Judge(options.truth, options.worlds, options.curve)
    print(report_merged(base, drives, options.out, options.report, judge, crew))
    for path in waiting:
        path.unlink(missing_ok=True)
    return OK
