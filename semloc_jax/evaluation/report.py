"""How metrics are shown, stored and held against a committed baseline (room: evaluation; host).

In: list[Metric]; those of a baseline. Out: a text table, a JSON file; one Verdict for each key.
"""

import enum
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.metrics import Metric
from semloc_jax.storage import write_text

_STATISTICS = ("median", "mean", "rmse", "p95", "max", "bias")


def format_metrics(metrics: Sequence[Metric]) -> str:
    """Text table: one row for each error with its statistics, then one line for each other number."""
    rows: dict[str, dict[str, Metric]] = {}
    single: list[Metric] = []
    for metric in metrics:
        name, _, statistic = metric.key.rpartition(".")
        if statistic in _STATISTICS:
            rows.setdefault(name, {})[statistic] = metric
        else:
            single.append(metric)
    lines = []
    if rows:
        lines.append(f"{'error':<16}" + "".join(f"{statistic:>10}" for statistic in _STATISTICS) + "  unit")
    for name, by_statistic in rows.items():
        cells = [f"{by_statistic[s].value:10.4f}" if s in by_statistic else " " * 10 for s in _STATISTICS]
        lines.append(f"{name:<16}" + "".join(cells) + f"  {next(iter(by_statistic.values())).unit}")
    lines += [f"{metric.key:<36}{_format_value(metric):>10}" for metric in single]
    return "\n".join(lines)


def _format_value(metric: Metric) -> str:
    if math.isnan(metric.value):
        return "n/a"
    if metric.unit == "share":
        return f"{100.0 * metric.value:.1f} %"
    if metric.unit == "frames":
        return f"{metric.value:.0f}"
    return f"{metric.value:.4g} {metric.unit}"


def write_metrics(metrics: Sequence[Metric], path: str | Path) -> None:
    """Write metrics as JSON; the file also serves as a baseline for `benchmark.compare`."""
    rows = [asdict(metric) | {"value": None if math.isnan(metric.value) else metric.value} for metric in metrics]
    write_text(path, json.dumps({"metrics": rows}, indent=1) + "\n")


def read_metrics(path: str | Path) -> list[Metric]:
    """Metrics of a JSON file.

    Raises:
        SemlocError: the file is missing or is not such a file.
    """
    path = Path(path)
    if not path.is_file():
        raise SemlocError(f"metrics {path}: no such file; expected a metrics.json; write one with write_metrics")
    try:
        rows = json.loads(path.read_bytes())["metrics"]
        return [Metric(**(row | {"value": math.nan if row["value"] is None else float(row["value"])})) for row in rows]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise SemlocError(
            f'metrics {path}: not a metrics file ({error!r}); expected {{"metrics": [{{"key", "value", "unit", '
            '"direction", "tolerance"}]}'
        ) from error


class Outcome(enum.StrEnum):
    """How a metric compares with its baseline."""

    SAME = "same"
    BETTER = "better"
    WORSE = "worse"
    MISSING = "missing"
    NEW = "new"


@dataclass(frozen=True)
class Verdict:
    """Outcome for one key; `value` or `baseline` is nan where that side lacks the key."""

    key: str
    value: float
    baseline: float
    unit: str
    outcome: Outcome

    @property
    def failed(self) -> bool:
        return self.outcome in (Outcome.WORSE, Outcome.MISSING)


def compare(metrics: Sequence[Metric], baseline: Sequence[Metric]) -> list[Verdict]:
    """Verdicts in the order of the baseline, new keys last.

    Direction and tolerance are those of the BASELINE, so that a run cannot loosen its own gate. A value that became
    nan is worse; keys of direction `report` are not compared.
    """
    current = {metric.key: metric for metric in metrics}
    verdicts = []
    for expected in baseline:
        if expected.direction == "report":
            continue
        metric = current.get(expected.key)
        value = math.nan if metric is None else metric.value
        outcome = Outcome.MISSING if metric is None else _judge(value, expected)
        verdicts.append(Verdict(expected.key, value, expected.value, expected.unit, outcome))
    known = {metric.key for metric in baseline}
    for metric in metrics:
        if metric.key not in known and metric.direction != "report":
            verdicts.append(Verdict(metric.key, metric.value, math.nan, metric.unit, Outcome.NEW))
    return verdicts


def _judge(value: float, expected: Metric) -> Outcome:
    if math.isnan(expected.value):
        return Outcome.SAME if math.isnan(value) else Outcome.BETTER
    if math.isnan(value):
        return Outcome.WORSE
    loss = value - expected.value if expected.direction == "lower" else expected.value - value
    if loss > expected.tolerance:
        return Outcome.WORSE
    return Outcome.BETTER if loss < -expected.tolerance else Outcome.SAME


def is_passed(verdicts: Iterable[Verdict]) -> bool:
    """True when no metric is worse than its baseline allows and none is missing."""
    return not any(verdict.failed for verdict in verdicts)


def format_verdicts(verdicts: Iterable[Verdict]) -> str:
    """One line for each metric that is not the same as before; a single line when all are."""
    lines = [
        f"{verdict.outcome.value:<8}{verdict.key:<36}{verdict.baseline:>10.4f} -> {verdict.value:.4f} {verdict.unit}"
        for verdict in verdicts
        if verdict.outcome is not Outcome.SAME
    ]
    return "\n".join(lines) if lines else "all metrics within tolerance of the baseline"
