"""The fault matrix judged on runs whose every frame is written by hand."""

from pathlib import Path

import numpy as np
import pytest

from semloc_jax.analysis.fault_matrix import judge_fault, to_markdown
from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.evaluation import Trajectory
from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.geometry import rigid
from semloc_jax.localization.track_state import TrackResult, TrackStatus
from semloc_jax.maps import SemanticMap
from semloc_jax.simulation.faults import FaultyDrive

T, D, L, N = TrackStatus.TRACKING, TrackStatus.DEGRADED, TrackStatus.LOST, TrackStatus.INITIALIZING


def along(x, y=0.0, yaw=0.0):
    return rigid.exp(np.array([x, y, 0.0, 0, 0, 0])) @ rigid.exp(np.array([0.0, 0, 0, 0, 0, yaw]))


def run(status, errors, from_s, to_s):
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
        results.append(TrackResult(f"{k:03d}", float(time_s[k]), state, fused=fused))
    return FaultyDrive("made", drive, SemanticMap(()), from_s, to_s), results


def test_a_fault_that_is_noticed_and_passes():
    status = [N, T, T, T, T, D, L, L, L, T, D, T, T, T]
    errors = [None, (0, 0.01), (0.02, 0), (0, 0), (0.1, 0, 0.002), (0.5, 0), (2.0, 0), (2.0, 1.0), (1, 0)]
    errors += [(0, 0.02), (0, 0), (0, 0), (0, 0), (0, -0.03)]
    found = judge_fault(*run(status, errors, from_s=0.4, to_s=0.8))
    assert found.noticed_s == pytest.approx(0.1) and found.recovered_s == pytest.approx(0.3)
    assert found.not_tracking_s == pytest.approx(0.5) and found.tracking == pytest.approx(8 / 14)
    assert (found.max_longitudinal_m, found.max_lateral_m) == pytest.approx((0.1, 0.03))
    assert found.max_heading_deg == pytest.approx(np.degrees(0.002), abs=1e-4)
    assert found.max_any_m == pytest.approx(np.hypot(2.0, 1.0)) and found.false_confident == 0


def test_false_confidence_is_counted_in_the_frame_of_the_vehicle():
    status = [T] * 6
    errors = [(0, 0), (0.28, 0.28), (0.3, 0), (0, 0.3), (0, 0, 0.01), (0, 0)]
    found = judge_fault(*run(status, errors, from_s=0.1, to_s=0.5))
    assert found.false_confident == 3
    assert np.isnan(found.noticed_s) and found.not_tracking_s == 0.0


def test_a_run_that_never_tracks_or_never_recovers():
    never = judge_fault(*run([N] * 5, [None] * 5, 0.1, 0.2))
    assert never.tracking == 0.0 and never.max_any_m == 0.0 and np.isnan(never.recovered_s)
    lost = judge_fault(*run([T, T, T, L, L, L], [(0, 0)] * 3 + [(9, 0)] * 3, 0.3, 0.4))
    assert np.isnan(lost.recovered_s) and lost.noticed_s == pytest.approx(0.0) and lost.max_any_m == pytest.approx(9.0)
    table = to_markdown([never, lost])
    assert table.count("\n") == 3 and "| - |" in table and "9.00 m" in table
