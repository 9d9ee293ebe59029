"""The baseline gate: did any metric get worse than a committed file allows (room: evaluation; host).

In: metrics of this run, metrics of a baseline. Out: one Verdict for each key.
"""

import enum
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from semloc_jax.evaluation.metrics import Metric


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
