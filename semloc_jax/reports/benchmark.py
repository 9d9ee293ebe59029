"""The reports of the benchmark: what `semloc bench`, also with --drives, measures, writes and judges (room: reports;
host).

In: which peers and sizes; few or all drives. Out: tables as text, a JSON file, a picture, a baseline, a verdict.
"""

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from semloc_jax.bench import drives, machine, peer, results, roofline, runner, tasks
from semloc_jax.evaluation import compare, format_verdicts, is_passed, read_metrics, write_metrics
from semloc_jax.storage import write_text
from semloc_jax.viz.bench import benchmark_figure
from semloc_jax.viz.style import save


@dataclass(frozen=True)
class BenchmarkPlan:
    """What is measured.

    Args:
        peers: Names of solvers.
        core: Core that each process is pinned to; None for none.
        repeats: Number of rounds.
        is_quick: Fewer sizes.
        has_curves: Whether many numbers of hypotheses and points are measured.
    """

    peers: Sequence[str]
    core: int | None
    repeats: int = 5
    is_quick: bool = False
    has_curves: bool = True


class BenchmarkFiles(NamedTuple):
    """What is written; None for nothing: all numbers, a picture, the baseline of this run."""

    data: Path | None = None
    plot: Path | None = None
    baseline: Path | None = None


class BenchmarkReport(NamedTuple):
    """The tables, and whether the run is as good as the baseline (True where there was none to compare with)."""

    text: str
    is_passed: bool


def report_benchmark(
    plan: BenchmarkPlan,
    files: BenchmarkFiles | None = None,
    has_gate: bool = False,
    baseline: Path | None = None,
    say: Callable[[str], None] = print,
) -> BenchmarkReport:
    """Measure every peer, write, and compare ratios and success rates with a baseline.

    Args:
        plan: What is measured.
        files: What is written; None for nothing.
        has_gate: Whether the run is compared with the baseline of the package.
        baseline: Another baseline to compare with.
        say: Called with a line on each step.
    """
    todo = tasks.tasks(plan.is_quick, plan.has_curves, plan.repeats)
    with tempfile.TemporaryDirectory() as folder:
        measured, missing = runner.run(plan.peers, todo, Path(folder), plan.core, not plan.is_quick, say)
    found = results.Results(measured)
    data = _data(found, missing, plan.core)
    lines = [results.table(found), "", results.ratio_table(found), "", roofline.lines(data["roofline"])]
    lines += [f"doubtful: {doubt}" for doubt in found.doubts()]
    lines += [f"not here: {name}: {reason}" for name, reason in missing.items()]
    lines += [f"failed: {failed.peer} {failed.task.key}: {failed.failed}" for failed in found.failed]
    _write(files or BenchmarkFiles(), found, data)
    if not has_gate and baseline is None:
        return BenchmarkReport("\n".join(lines), True)
    asked = [f"{name}.{task.key}" for name in plan.peers for task in todo if task.suits(peer.entry(name))]
    expected = results.comparable(read_metrics(baseline or results.BASELINE), asked, list(missing))
    verdicts = compare(results.metrics(found), expected)
    return BenchmarkReport("\n".join([*lines, format_verdicts(verdicts)]), is_passed(verdicts))


def _data(found: results.Results, missing: dict[str, str], core: int | None) -> dict[str, Any]:
    """Everything that was measured, with machine, versions and command."""
    data = {"machine": machine.machine(), "versions": machine.versions(), "core": core}
    data |= {"command": ["semloc", *sys.argv[1:]], "missing": missing, **results.as_data(found)}
    data["roofline"] = roofline.as_data(roofline.roofs_of(core), tasks.NUM_POINTS, found.evaluation_us())
    return data


def _write(files: BenchmarkFiles, found: results.Results, data: dict[str, Any]) -> None:
    if files.data is not None:
        write_text(files.data, json.dumps(data, indent=1) + "\n")
    if files.baseline is not None:
        write_metrics(results.metrics(found), files.baseline)
    if files.plot is not None:
        save(benchmark_figure(data), files.plot)


def report_drive_benchmark(
    is_quick: bool,
    files: BenchmarkFiles | None = None,
    has_gate: bool = False,
    baseline: Path | None = None,
    say: Callable[[str], None] = print,
) -> BenchmarkReport:
    """Localize and track simulated drives in processes of their own, write, and compare with a baseline.

    Args:
        is_quick: Only the drive of one camera, and no two drives at once.
        files: What is written; None for nothing. There is no picture.
        has_gate: Whether the run is compared with the baseline of the package.
        baseline: Another baseline to compare with.
        say: Called with a line on each step.
    """
    cases, files = drives.CASES[:1] if is_quick else drives.CASES, files or BenchmarkFiles()
    with tempfile.TemporaryDirectory() as folder:
        runs, fleets = drives.measure_drives(cases, Path(folder), not is_quick, say)
    metrics = drives.metrics(runs)
    if files.data is not None:
        data = {"machine": machine.machine(), "versions": machine.versions(), "command": ["semloc", *sys.argv[1:]]}
        data |= {"runs": [asdict(run) for run in runs], "fleets": [fleet._asdict() for fleet in fleets]}
        write_text(files.data, json.dumps(data, indent=1) + "\n")
    if files.baseline is not None:
        write_metrics(metrics, files.baseline)
    text = "\n".join([*run_lines(runs), *fleet_lines(fleets)])
    if not has_gate and baseline is None:
        return BenchmarkReport(text, True)
    ours = {metric.key.rsplit(".over.", 1)[0].rsplit(".", 1)[0] for metric in metrics}
    expected = [
        metric
        for metric in read_metrics(baseline or drives.BASELINE)
        if any(metric.key.startswith(f"{prefix}.") for prefix in ours)
    ]
    verdicts = compare(metrics, expected)
    return BenchmarkReport(f"{text}\n{format_verdicts(verdicts)}", is_passed(verdicts))


def run_lines(runs: Sequence[drives.DriveRun]) -> list[str]:
    """A row for each verb and drive: CPU and wall time of the start, cold and warm, and of a frame; stages, memory."""
    lines = [
        f"{'verb':<9}{'drive':<19}{'cold start s':>15}{'warm start s':>15}{'a frame ms':>13}{'frames / core h':>17}"
        f"{'MiB':>6}{'good':>6}  stages, wall ms"
    ]
    for run in runs:
        cold, warm = (f"{spent.cpu_s:.1f} ({spent.wall_s:.1f})" for spent in (run.cold, run.warm))
        frame, hour = f"{run.frame_cpu_ms:.0f} ({run.frame_wall_ms:.0f})", 3.6e6 / run.frame_cpu_ms
        stages = ", ".join(f"{name} {value:.1f}" for name, value in run.stages_ms.items())
        lines.append(
            f"{run.verb:<9}{run.case.name:<19}{cold:>15}{warm:>15}{frame:>13}{hour:>17.0f}"
            f"{run.whole.peak_mib:>6.0f}{run.good:>6.0%}  {stages}"
        )
    spread = max(run.spread for run in runs)
    lines.append("CPU time, in brackets wall time; a start is that of a process with its first three frames")
    lines.append(f"the same small work cost up to {spread:.0%} more or less CPU time while this was measured")
    return lines


def fleet_lines(fleets: Sequence[drives.FleetRun]) -> list[str]:
    """A row for each verb and number of jobs: frames an hour of one core, and of the machine."""
    if not fleets:
        return []
    lines = ["", f"{'two drives':<12}{'jobs':>5}{'CPU s':>8}{'wall s':>8}{'frames / core h':>17}{'frames / h':>12}"]
    for fleet in fleets:
        spent = f"{fleet.spent.cpu_s:>8.1f}{fleet.spent.wall_s:>8.1f}"
        lines.append(f"{fleet.verb:<12}{fleet.jobs:>5}{spent}{fleet.per_core_hour:>17.0f}{fleet.per_hour:>12.0f}")
    return lines
