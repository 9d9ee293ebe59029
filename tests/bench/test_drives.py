"""Whole commands as the benchmark of drives measures them: what a process used, ratios and gate on made-up runs."""

import dataclasses

import numpy as np
import pytest

from semloc_jax.bench import drives
from semloc_jax.bench.drives import DriveCase, DriveRun, FleetRun, Spent
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import compare, is_passed, read_metrics
from semloc_jax.reports.benchmark import fleet_lines, run_lines

CASE = DriveCase("road, 1 camera", "road", 43)
RUN = DriveRun(
    "track",
    CASE,
    Spent(30.0, 25.0, 900.0),
    Spent(4.0, 5.0, 700.0),
    Spent(6.0, 9.0, 800.0),
    {"align": 5.0},
    2.0,
    0.95,
    1.0,
    0.1,
)


def test_a_frame_is_what_the_whole_drive_costs_beyond_its_start():
    assert RUN.frame_cpu_ms == pytest.approx(50)
    assert RUN.frame_wall_ms == pytest.approx(100)
    (line,) = [line for line in run_lines([RUN]) if line.startswith("track")]
    assert "30.0 (25.0)" in line and "50 (100)" in line and "72000" in line and "95%" in line


def test_two_drives_on_two_cores_take_half_the_time_and_the_same_cpu():
    one, two = FleetRun("track", 1, 80, Spent(8.0, 8.0, 900.0)), FleetRun("track", 2, 80, Spent(8.0, 4.0, 900.0))
    assert two.per_core_hour == one.per_core_hour == 36000
    assert two.per_hour == 2 * one.per_hour
    assert len(fleet_lines([one, two])) == 4 and not fleet_lines([])


def test_the_gate_closes_when_a_start_or_frames_get_worse():
    baseline = drives.metrics([RUN])

    def passes(**changes):
        return is_passed(compare(drives.metrics([dataclasses.replace(RUN, **changes)]), baseline))

    assert passes()
    assert passes(cold=Spent(36.0, 25.0, 900.0)), "noise of a fifth passes"
    assert not passes(cold=Spent(42.0, 25.0, 900.0))
    assert not passes(good=0.7)
    slow = {name: Spent(*(2 * value for value in getattr(RUN, name)[:2]), 900.0) for name in ("cold", "warm", "whole")}
    assert passes(**slow, yardstick_ms=4.0, start_s=2.0), "a slow machine is slow for the yardsticks too"


def test_the_baseline_of_the_package_has_every_drive_and_verb():
    keys = {metric.key for metric in read_metrics(drives.BASELINE)}
    runs = [dataclasses.replace(RUN, verb=verb, case=case) for verb in drives.VERBS for case in drives.CASES]
    assert keys == {metric.key for metric in drives.metrics(runs)}


def test_a_process_tells_what_it_used_and_why_it_failed(tmp_path):
    spent = drives._run(["--version"], tmp_path)
    assert 0 < spent.cpu_s < 60 and spent.peak_mib > 5
    with pytest.raises(SemlocError, match="exit code 2.*unknown verb"):
        drives._run(["fly"], tmp_path)


def test_the_yardstick_is_paid_by_the_frame(tmp_path):
    import cv2

    paths = [tmp_path / f"{k}.png" for k in range(4)]
    for path in paths:
        cv2.imwrite(str(path), np.eye(200, dtype=np.uint8))
    assert drives.yardstick(paths, 2) > 0
