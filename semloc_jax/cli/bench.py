"""`semloc bench`: the same problem through our solver and every peer that is installed (room: cli)."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_jax.cli.main import LOST, OK
from semloc_jax.errors import UsageError
from semloc_jax.inputs.choices import parse_names
from semloc_jax.storage import write_text

if TYPE_CHECKING:
    from semloc_jax.bench.results import Results


@dataclass(frozen=True)
class Options:
    """Hypotheses per second of this package and of its peers, side by side, on this machine.

    The same points, cost maps, starts, prior and stopping rule go to every solver. Each runs in a process of its own,
    pinned to one core; they take turns, so that ratios hold on a busy machine. Peers that are not installed are named
    and left out. With --gate the exit code is 3 when a ratio or a success rate fell below the committed baseline.
    """

    quick: bool = False
    """A minute's worth: fewer peers, fewer sizes, no curves."""
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
    """Core to pin to; by default the last one that is free to us."""
    gate: bool = False
    """Compare ratios and success rates with the baseline."""
    baseline: Path | None = None
    """Another baseline than the one in the package."""
    write_baseline: Path | None = None
    """Write the ratios and success rates of this run as a baseline."""


def run(options: Options) -> int:
    """Measure, print, write, judge."""
    import tempfile

    from semloc_jax.bench import machine, peer, results, roofline, runner, tasks

    names, core = _names(options), _core(options.core)
    if options.repeats < 1:
        raise UsageError(f"--repeats {options.repeats}: expected at least 1")
    for path in (options.json, options.plot, options.write_baseline):
        if path is not None and not path.resolve().parent.is_dir():
            raise UsageError(f"{path}: its folder does not exist")
    todo = tasks.tasks(options.quick, not options.no_curves, options.repeats)
    with tempfile.TemporaryDirectory() as folder:
        measured, missing = runner.run(names, todo, Path(folder), core, not options.quick, _say)
    found = results.Results(measured)
    data = {"machine": machine.machine(), "versions": machine.versions(), "core": core}
    data |= {"command": ["semloc", *sys.argv[1:]], "missing": missing, **results.as_data(found)}
    data["roofline"] = roofline.as_data(roofline.roofs_of(core), tasks.NUM_POINTS, found.evaluation_us())
    print(results.table(found), results.ratio_table(found), roofline.lines(data["roofline"]), sep="\n\n")
    for doubt in found.doubts():
        print(f"doubtful: {doubt}")
    for name, reason in missing.items():
        print(f"not here: {name}: {reason}")
    for measurement in found.failed:
        print(f"failed: {measurement.peer} {measurement.task.key}: {measurement.failed}")
    _write(options, found, data)
    asked = [f"{name}.{task.key}" for name in names for task in todo if task.suits(peer.entry(name))]
    return _judge(options, found, asked, list(missing))


def _write(options: Options, found: "Results", data: dict) -> None:
    from semloc_jax.bench.results import metrics

    if options.json is not None:
        write_text(options.json, json.dumps(data, indent=1) + "\n")
    if options.write_baseline is not None:
        from semloc_jax.evaluation import write_metrics

        write_metrics(metrics(found), options.write_baseline)
    if options.plot is not None:
        from semloc_jax.viz.bench import benchmark_figure
        from semloc_jax.viz.style import save

        save(benchmark_figure(data), options.plot)


def _judge(options: Options, found: "Results", asked: list[str], missing: list[str]) -> int:
    if not options.gate and options.baseline is None:
        return OK
    from semloc_jax.bench import results
    from semloc_jax.evaluation import compare, format_verdicts, is_passed, read_metrics

    baseline = read_metrics(options.baseline or results.BASELINE)
    verdicts = compare(results.metrics(found), results.comparable(baseline, asked, missing))
    print(format_verdicts(verdicts))
    return OK if is_passed(verdicts) else LOST


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


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
