"""The gate closes on worse and missing metrics only, by the baseline's own tolerance."""

import math

import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import (
    Metric,
    Outcome,
    compare,
    format_metrics,
    format_verdicts,
    is_passed,
    read_metrics,
    write_metrics,
)

BASELINE = [
    Metric("lateral.median", 0.10, "m", "lower", 0.01),
    Metric("available.1m", 0.95, "share", "higher", 0.02),
    Metric("lateral.bias", 0.01, "m", "report"),
]


def outcomes(*values):
    run = [Metric(b.key, v, b.unit, b.direction, 99.0) for b, v in zip(BASELINE, values, strict=False)]
    return [verdict.outcome for verdict in compare(run, BASELINE)]


def test_direction_and_tolerance_are_the_baselines():
    assert outcomes(0.105, 0.94, 5.0) == [Outcome.SAME, Outcome.SAME]
    assert outcomes(0.12, 0.99) == [Outcome.WORSE, Outcome.BETTER]
    assert outcomes(0.05, 0.90) == [Outcome.BETTER, Outcome.WORSE]
    assert outcomes(math.nan, 0.95) == [Outcome.WORSE, Outcome.SAME]


def test_a_missing_metric_fails_and_a_new_one_does_not():
    verdicts = compare([BASELINE[0], Metric("new", 1.0, "m")], BASELINE)
    assert [verdict.outcome for verdict in verdicts] == [Outcome.SAME, Outcome.MISSING, Outcome.NEW]
    assert not is_passed(verdicts)
    assert is_passed(compare(BASELINE, BASELINE))
    assert "missing" in format_verdicts(verdicts)


def test_metrics_round_trip_with_nan(tmp_path):
    metrics = [*BASELINE, Metric("speed", math.nan, "ms")]
    write_metrics(metrics, tmp_path / "m.json")
    back = read_metrics(tmp_path / "m.json")
    assert back[:3] == BASELINE
    assert math.isnan(back[3].value)


def test_table_has_units_and_every_number():
    text = format_metrics(BASELINE)
    assert "lateral" in text and "0.1000" in text and "  m" in text
    assert "95.0 %" in text


def test_a_wrong_file_is_named(tmp_path):
    (tmp_path / "m.json").write_text('{"other": 1}')
    with pytest.raises(SemlocError, match="not a metrics file"):
        read_metrics(tmp_path / "m.json")
