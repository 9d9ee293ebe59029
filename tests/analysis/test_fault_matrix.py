"""The fault matrix judged on runs whose every frame is written by hand."""

from pathlib import Path

import numpy as np
import pytest

from semloc_jax.analysis.fault_matrix import judge_fault, judged, to_markdown, worst_first
from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.evaluation import Trajectory
from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.geometry import rigid
from semloc_jax.localization.track_state import TrackResult, TrackStatus
from semloc_jax.maps import SemanticMap
from semloc_jax.reports.fault_tables import reliability
from semloc_jax.simulation.faults import FaultyDrive
from semloc_jax.simulation.hostile import FaultRow

ROW = FaultRow("made", 2, "5 m", "map")
T, D, L, N = TrackStatus.TRACKING, TrackStatus.DEGRADED, TrackStatus.LOST, TrackStatus.INITIALIZING


def along(x, y=0.0, yaw=0.0):
    return rigid.exp(np.array([x, y, 0.0, 0, 0, 0])) @ rigid.exp(np.array([0.0, 0, 0, 0, 0, yaw]))


def run(status, errors, from_s, to_s, levels=(0.29, 0.29, 0.5)):
    """A drive of 10 Hz and 1 m a frame that turns left by 90 deg, and results with the given status and errors."""
    num = len(status)
    time_s = 0.1 * np.arange(num)
    poses = np.array([along(0.0, yaw=np.pi / 2) @ along(float(k)) for k in range(num)])
    rig = Rig([PinholeCamera(10.0, 10.0, 5.0, 5.0, 10, 10)], np.eye(4)[None], ["front"])
    frames = tuple(Frame(k, f"{k:03d}", float(time_s[k]), "", rig, {}) for k in range(num))
    drive = Drive("made", Path("."), frames, rig, truth=Trajectory(time_s, poses))
    results = []
    for k, (state, off) in enumerate(zip(status, errors, strict=True)):
        fused = (
            None
            if off is None
            else FusedPose(float(time_s[k]), poses[k] @ along(*off), np.eye(6), 1.0, 0.0, np.zeros(2))
        )
        reasons = (f"{k} posts are aside",) if state != T else ()
        results.append(TrackResult(f"{k:03d}", float(time_s[k]), state, reasons, fused, levels))
    return FaultyDrive("made", drive, SemanticMap(()), from_s, to_s), results


def test_a_fault_that_is_noticed_and_passes():
    status = [N, T, T, T, T, D, L, L, L, T, D, T, T, T]
    errors = [None, (0, 0.01), (0.02, 0), (0, 0), (0.1, 0, 0.002), (0.5, 0), (2.0, 0), (2.0, 1.0), (1, 0)]
    errors += [(0, 0.02), (0, 0), (0, 0), (0, 0), (0, -0.03)]
    found = judge_fault(ROW, *run(status, errors, from_s=0.4, to_s=0.8))
    assert found.noticed_s == pytest.approx(0.1) and found.recovered_s == pytest.approx(0.3)
    assert (found.tracking, found.frames) == (8, 14)
    assert (found.max_longitudinal_m, found.max_lateral_m) == pytest.approx((0.1, 0.03))
    assert found.max_heading_deg == pytest.approx(np.degrees(0.002), abs=1e-4)
    assert found.max_any_m == pytest.approx(np.hypot(2.0, 1.0)) and found.beyond_alert == found.false == 0
    assert found.refused_right == 1 and found.reason == "0 posts are aside"


def test_false_confidence_is_counted_in_the_frame_of_the_vehicle():
    status = [T] * 6
    errors = [(0, 0), (0.28, 0.28), (0.3, 0), (0, 0.3), (0, 0, 0.01), (0, 0)]
    found = judge_fault(ROW, *run(status, errors, from_s=0.1, to_s=0.5))
    assert found.beyond_alert == found.false == 3
    assert np.isnan(found.noticed_s)


def test_a_run_that_never_tracks_or_never_recovers():
    never = judge_fault(ROW, *run([N] * 5, [None] * 5, 0.1, 0.2))
    assert never.tracking == 0 and never.max_any_m == 0.0 and np.isnan(never.recovered_s)
    lost = judge_fault(ROW, *run([T, T, T, L, L, L], [(0, 0)] * 3 + [(9, 0)] * 3, 0.3, 0.4))
    assert np.isnan(lost.recovered_s) and lost.noticed_s == pytest.approx(0.0) and lost.max_any_m == pytest.approx(9.0)
    table = to_markdown([never, lost])
    assert table.count("\n") == 3 and "| - |" in table and "9.00 m" in table


def test_an_error_beyond_its_level_is_false_though_within_the_alert_limits():
    """The worst frames come first, what nothing can see last, what is healthy at the top."""
    fault, results = run([T] * 4, [(0, 0), (0.0, 0.06), (0.05, 0.0), (0, 0, 0.001)], 0.0, 0.4, (0.05, 0.1, 0.1))
    found = judge_fault(ROW, fault, results)
    assert (found.false, found.beyond_alert) == (1, 0)
    unseen = judge_fault(FaultRow("unseen", 1, "1 m", "map", "nothing sees it"), fault, results)
    healthy = judge_fault(FaultRow("none", 0, "", ""), fault, results)
    right = judge_fault(FaultRow("right", 1, "1 m", "map"), *run([T] * 4, [(0, 0)] * 4, 0.0, 0.4))
    assert [o.fault for o in worst_first([unseen, right, found, healthy])] == ["none", "made", "right", "unseen"]
    assert not unseen.counts and not healthy.counts and found.counts and "nothing can see it" in to_markdown([unseen])


def test_levels_and_sigmas_stand_in_the_order_of_the_errors():
    """Covariance by (forward, left, ..., heading), errors by (lateral, longitudinal, heading)."""
    fault, results = run([T], [(0.3, 0.1, 0.02)], 0.0, 0.1, (1.0, 2.0, 3.0))
    results[0].fused.covariance[:] = np.diag([4.0, 9.0, 0.0, 0.0, 0.0, np.radians(2.0) ** 2])
    one = judged(fault.drive, results)
    np.testing.assert_allclose(one.sigmas, [[3.0, 2.0, 2.0]])
    np.testing.assert_allclose(one.errors[0], [0.1, 0.3, np.degrees(0.02)], atol=2e-3)
    np.testing.assert_allclose(one.levels, [[1.0, 2.0, 3.0]])


def test_stated_bounds_hold_the_share_that_they_state():
    errors = np.abs(np.random.default_rng(0).normal(size=(20000, 3))) * [1.0, 2.0, 0.1]
    rows = reliability(errors, np.tile([1.0, 2.0, 0.05], (20000, 1)))
    assert [row[0] for row in rows] == [0.68, 0.95, 0.997]
    np.testing.assert_allclose([row[1:3] for row in rows], [[0.68] * 2, [0.95] * 2, [0.997] * 2], atol=0.012)
    # Sigmas that are half of the errors hold 38 % instead of 68 %.
    assert rows[0][3] == pytest.approx(0.38, abs=0.012)
