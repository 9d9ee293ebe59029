"""Drift as KITTI measures it, on errors whose size is known."""

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory, drift
from semloc_jax.geometry import rigid


def way(num=400, step_m=1.0, turn_rad=0.0, scale=1.0):
    step = rigid.exp(np.array([step_m * scale, 0.0, 0.0, 0.0, 0.0, 0.01 + turn_rad]))
    poses = [np.eye(4)]
    for _ in range(num - 1):
        poses.append(poses[-1] @ step)
    return Trajectory(np.arange(num, dtype=float), np.stack(poses))


def of(estimate, reference):
    return {metric.key: metric.value for metric in drift(estimate, reference)}


def test_a_wrong_scale_is_its_percentage_in_any_frame():
    truth = way(num=250)
    straight = Trajectory(truth.time_s, np.tile(np.eye(4), (250, 1, 1)))
    straight.T_map_base[:, 0, 3] = np.arange(250)
    longer = Trajectory(truth.time_s, straight.T_map_base.copy())
    longer.T_map_base[:, 0, 3] *= 1.02
    moved = rigid.exp(np.array([30.0, -5.0, 2.0, 0.1, 0.2, 2.0]))
    found = of(Trajectory(truth.time_s, moved @ longer.T_map_base), straight)
    assert found["drift.translation"] == pytest.approx(2.0, abs=1e-6)
    assert found["drift.end"] == pytest.approx(2.0, abs=1e-6)
    assert found["drift.rotation"] == pytest.approx(0.0, abs=1e-9)
    assert (found["drift.shortest"], found["drift.longest"], found["drift.way"]) == (100.0, 200.0, 249.0)


def test_a_steady_turn_is_its_rate_per_metre():
    truth = way()
    found = of(way(turn_rad=np.deg2rad(0.002)), truth)
    assert found["drift.rotation"] == pytest.approx(0.002, rel=0.01)


def test_a_short_drive_is_judged_over_stretches_of_its_own():
    found = of(way(num=41, scale=1.1), way(num=41))
    assert found["drift.translation"] == pytest.approx(10.0, rel=0.02)
    assert found["drift.longest"] < 40.0


def test_what_has_no_way_is_refused():
    still = Trajectory(np.arange(3.0), np.tile(np.eye(4), (3, 1, 1)))
    with pytest.raises(SemlocError, match=r"moved 0\.00 m"):
        drift(still, still)
    with pytest.raises(SemlocError, match="expected at least 2"):
        drift(Trajectory(still.time_s + 100.0, still.T_map_base), way(num=3))
