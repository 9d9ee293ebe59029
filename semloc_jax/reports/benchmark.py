"""The report of the benchmark: what `semloc bench` measures, writes and judges (room: reports; host).

In: which peers and sizes. Out: tables as text, a JSON file, a picture, a baseline, a verdict.
"""

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from semloc_jax.bench import machine, peer, results, roofline, runner, tasks
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
