"""`semloc bench`: the same problem through our solver and every peer that is installed (room: cli)."""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from semloc_jax.cli.main import LOST, OK
from semloc_jax.errors import UsageError
from semloc_jax.inputs.choices import parse_names


@dataclass(frozen=True)
class Options:
    """Hypotheses per second of this package and of its peers, side by side, on this machine.

    The same points, cost maps, starts, prior and stopping rule go to every solver. Each runs in a process of its own,
    pinned to one core; they take turns, so that ratios hold on a busy machine. Peers that are not installed are named
    and left out. With --gate the exit code is 3 when a ratio or a success rate fell below the committed baseline.

    --landmarks asks another question, about accuracy: how the error falls with the number of signs and lamp posts of a
    compact map, simulated, beside the least error that is possible (Cramer and Rao); --json and --plot as above.

    --drives measures what a user waits for: localize and track on simulated drives of one and four cameras, each in a
    process of its own, with nothing compiled and warm: CPU and wall time of the start and of a frame, its stages,
    memory, and two drives with --jobs 1 and 2. --gate then compares with the committed baseline, in units of what the
    machine takes to decode masks.
    """

    quick: bool = False
    """A minute's worth: fewer peers, fewer sizes, no curves."""
    landmarks: bool = False
    """Error against number of landmarks, 54 signs, 136 posts and lanes on roads of 0.5 to 4 km; no peers."""
    drives: bool = False
    """Whole commands on simulated drives, cold and warm; no peers. --quick: one camera only."""
    peers: str | None = None
    """Comma-separated names; `all` for every one (default of a full run)."""
    json: Path | None = None
    """Write everything that was measured, with machine, versions and command."""
    plot: Path | None = None
    """Write a picture (.png): cost against hypotheses and points, memory, roofline."""
    no_curves: bool = False
    """Leave the curves out (1 to 65536 hypotheses, 128 to 32768 points)."""
    repeats: int = 5
    """Rounds."""
    core: int | None = None
    """Core to pin to; default: the last one that this process may use."""
    gate: bool = False
    """Compare ratios and success rates with the baseline."""
    baseline: Path | None = None
    """A baseline to use instead of that of the package."""
    write_baseline: Path | None = None
    """Write the ratios and success rates of this run as a baseline."""


def run(options: Options) -> int:
    """Measure, print the tables and the verdict."""
    plan = (_names(options), _core(options.core), options.repeats, options.quick, not options.no_curves)
    if options.repeats < 1:
        raise UsageError(f"--repeats {options.repeats}: expected at least 1")
    files = (options.json, options.plot, options.write_baseline)
    for path in files:
        if path is not None and not path.resolve().parent.is_dir():
            raise UsageError(f"{path}: its folder does not exist")
    if options.landmarks:
        return _landmarks(options)
    if options.drives:
        return _drives(options, files)
    from semloc_jax.reports.benchmark import BenchmarkFiles, BenchmarkPlan, report_benchmark

    say = partial(print, file=sys.stderr, flush=True)
    report = report_benchmark(BenchmarkPlan(*plan), BenchmarkFiles(*files), options.gate, options.baseline, say)
    print(report.text)
    return OK if report.is_passed else LOST


def _landmarks(options: Options) -> int:
    from semloc_jax.bench.landmarks import LandmarkPlan
    from semloc_jax.reports.landmarks import report_landmarks

    plan = LandmarkPlan(roads_m=(2000.0, 500.0), seeds=(0,)) if options.quick else LandmarkPlan()
    print(report_landmarks(plan, options.json, options.plot, partial(print, file=sys.stderr, flush=True)))
    return OK


def _drives(options: Options, files: tuple[Path | None, ...]) -> int:
    from semloc_jax.reports.benchmark import BenchmarkFiles, report_drive_benchmark

    if options.plot is not None:
        raise UsageError(f"--plot {options.plot}: --drives draws nothing; --json has all numbers")
    say = partial(print, file=sys.stderr, flush=True)
    report = report_drive_benchmark(options.quick, BenchmarkFiles(*files), options.gate, options.baseline, say)
    print(report.text)
    return OK if report.is_passed else LOST


def _core(wanted: int | None) -> int | None:
    from semloc_jax.bench import machine

    free = machine.cores()
    if wanted is not None and wanted not in free:
        raise UsageError(f"--core {wanted}: not free to this process; expected one of {free}")
    return free[-1] if wanted is None and free else wanted


def _names(options: Options) -> list[str]:
    from semloc_jax.bench.peer import PEERS, QUICK

    known = [entry.name for entry in PEERS]
    if options.peers is None:
        return list(QUICK) if options.quick else known
    names = parse_names(options.peers) or ()
    if names == ("all",):
        return known
    if unknown := [name for name in names if name not in known]:
        raise UsageError(f"--peers: unknown '{unknown[0]}'; expected names of {', '.join(known)}")
    return list(names)
