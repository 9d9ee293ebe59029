"""Ratios, table and gate on made-up measurements; the committed baseline; what a peak of a core is."""

import dataclasses
import json

import numpy as np
import pytest

from semloc_jax.bench import results, roofline
from semloc_jax.bench.peer import OURS, PEERS
from semloc_jax.bench.results import BASELINE, Results, comparable, metrics
from semloc_jax.bench.runner import Measurement
from semloc_jax.bench.tasks import Task, tasks
from semloc_jax.evaluation import compare, is_passed, read_metrics

COST_MS = {"semloc-analytic": 0.1, "semloc-xla": 0.5, "optimistix": 4.0, "scipy-jacobian": 12.0, "ceres-tiny": 1.0}
TASKS = [Task("one", 16, repeats=3), Task("many", 64, repeats=3), Task("many", 1024, repeats=3)]
ASKED = [f"{peer}.{task.key}" for peer in COST_MS for task in TASKS]


def measured(peer, task, each_ms, success=0.6):
    total_s = each_ms * 1e-3 * task.starts
    return Measurement(
        peer, task, 1.0, [total_s, 1.02 * total_s, 0.97 * total_s], [total_s] * 3, success, 20.0, 500.0, 400.0
    )


def a_run(slower=None, success=None):
    """Measurements with some costs changed by a factor."""
    slower, success = slower or {}, success or {}
    return Results(
        [
            measured(peer, task, cost * slower.get(peer, 1.0), success.get(peer, 0.6))
            for peer, cost in COST_MS.items()
            for task in TASKS
        ]
    )


def judge(run, baseline, missing=()):
    return is_passed(compare(metrics(run), comparable(baseline, ASKED, list(missing))))


def test_ratios_are_of_one_solve_and_by_rounds():
    ratio = a_run().ratio("semloc-analytic", "many-1024", "ceres-tiny", "many-64")
    assert ratio.value == pytest.approx(10.0)
    assert ratio.low == pytest.approx(10.0) and ratio.high == pytest.approx(10.0), "rounds are slow together"
    assert a_run().ratio("semloc-analytic", "many-1024", "gtsam", "many-64") is None


def test_the_gate_closes_when_a_ratio_worsens():
    baseline = metrics(a_run())
    assert judge(a_run(), baseline)
    assert judge(a_run({"semloc-xla": 1.2}), baseline), "noise of a fifth passes"
    assert not judge(a_run({"semloc-xla": 1.6}), baseline)
    assert not judge(a_run({"semloc-analytic": 1.6}), baseline)
    assert judge(a_run({peer: 3.0 for peer in COST_MS}), baseline), "a slow machine is slow for everyone"
    assert judge(a_run({"ceres-tiny": 0.1}), baseline), "what may be missing is reported only"
    assert not judge(a_run(success={"semloc-xla": 0.55}), baseline), "fast and wrong is not fast"


def test_what_was_not_measured_fails_unless_it_is_missing_for_a_reason():
    baseline = metrics(a_run())
    rest = Results([m for m in a_run().measurements if m.peer != "semloc-analytic"])
    assert not judge(rest, baseline)
    assert judge(rest, baseline, missing=["semloc-analytic"])
    brief = [name for name in ASKED if not name.endswith("one-16")]
    short = Results([m for m in a_run().measurements if m.task.kind == "many"])
    assert is_passed(compare(metrics(short), comparable(baseline, brief, [])))


def test_a_solver_of_another_problem_is_pointed_out():
    assert a_run().doubts() == []
    (doubt,) = a_run(success={"semloc-analytic": 0.0}).doubts()
    assert "success 0.00 where 0.60 is usual" in doubt


def test_table_has_every_peer_and_spread():
    text = results.table(a_run())
    assert "0.100 ±1 %" in text and "12.000" in text
    assert "10.0 (10.0 - 10.0)" in results.ratio_table(a_run())
    data = json.loads(json.dumps(results.as_data(a_run())))
    row = next(row for row in data["rows"] if row["peer"] == "semloc-analytic" and row["task"] == "many-1024")
    assert row["starts_per_second"] == pytest.approx(10000)


def test_rounds_left_out_do_not_count():
    task = Task("many", 64, repeats=3)
    one = dataclasses.replace(measured("semloc-xla", task, 0.5), cpu_s=[float("nan"), 0.064, float("nan")])
    assert one.median_ms == pytest.approx(1.0)
    nothing = dataclasses.replace(one, cpu_s=[])
    assert np.isnan(nothing.median_ms)
    assert results.table(Results([nothing]))


def test_a_brief_run_measures_part_of_a_full_one():
    brief, full = tasks(True, False, 3), tasks(False, True, 3)
    assert {task.key for task in brief} < {task.key for task in full}
    assert {task.starts for task in full if task.kind == "many" and task.points == 1000} >= {1, 65536}
    assert {task.points for task in full} >= {128, 32768}
    sequential = next(entry for entry in PEERS if entry.name == "ceres-tiny")
    assert not any(task.suits(sequential) for task in full if task.kind == "search" or task.starts > 256)


def test_the_committed_baseline_gates_every_path_of_ours():
    baseline = read_metrics(BASELINE)
    gated = [metric for metric in baseline if metric.direction == "higher"]
    for ours in OURS:
        assert any(m.key.startswith(f"{ours}.many-1024.over.optimistix") and m.tolerance > 0 for m in gated)
    # An empty run of the same extent must not pass.
    asked = [f"{entry.name}.{task.key}" for entry in PEERS for task in tasks(True, False, 1) if task.suits(entry)]
    assert not is_passed(compare([], comparable(baseline, asked, [])))


def test_roofline_numbers_follow_from_each_other():
    roofs = roofline.Roofs(matmul_gflops=180.0, stream_gbps=20.0, cache_gbps=60.0, gather_mps=500.0)
    data = roofline.as_data(roofs, 1000, {"ours": 4.0})
    assert data["flop_a_point"] == 180
    assert data["floor_us"] == pytest.approx({"arithmetic": 1.0, "cache": 0.4, "texels": 2.0})
    assert data["paths"][0]["gflops"] == pytest.approx(45.0)
    assert data["paths"][0]["share_of_peak"] == pytest.approx(0.25)
    assert "25.0 %" in roofline.lines(data)


def test_a_peak_is_its_work_over_the_time_of_a_call(monkeypatch):
    def in_a_millisecond(call, seconds):
        call()
        return 1e-3

    # What a call takes is the machine's; another process beside it made a copy in cache the slower one.
    monkeypatch.setattr(roofline, "_best", in_a_millisecond)
    roofs = roofline.measure_roofs()
    assert roofs.matmul_gflops == pytest.approx(2 * 768**3 * 1e-6)
    assert roofs.stream_gbps == pytest.approx(2 * 4 * 2**25 * 1e-6)
    assert roofs.cache_gbps == pytest.approx(2 * 4 * 2**16 * 1e-6)
    assert roofs.gather_mps == pytest.approx(2**16 * 1e-3)


def test_the_time_of_a_call_is_the_least_of_groups(monkeypatch):
    clock = SlowClock(call_s=2.0, late_s=7.0)
    monkeypatch.setattr(roofline.time, "process_time", clock.read)
    assert roofline._best(clock.work, seconds=30.0) == pytest.approx(2.0)


class SlowClock:
    """A clock that only work moves; every third call is disturbed."""

    def __init__(self, call_s, late_s):
        self.call_s, self.late_s, self.now_s, self.calls = call_s, late_s, 0.0, 0

    def read(self):
        return self.now_s

    def work(self):
        self.calls += 1
        self.now_s += self.late_s if self.calls % 3 == 0 else self.call_s
