"""How metrics are shown and stored (room: evaluation; host).

In: list[Metric]. Out: a text table, a JSON file.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
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
