"""The report of whole commands: what `semloc bench --drives` measures, writes and judges (room: reports; host).

In: whether few or all drives. Out: tables as text, a JSON file, a baseline, a verdict.
"""

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from semloc_jax.bench import drives, machine
from semloc_jax.evaluation import compare, format_verdicts, is_passed, read_metrics, write_metrics
from semloc_jax.reports.benchmark import BenchmarkFiles, BenchmarkReport
from semloc_jax.storage import write_text


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
