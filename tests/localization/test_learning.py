"""What frames say of the errors of measured poses where some are refused, and a first pose that is solved again."""

import numpy as np
import pytest

from semloc_jax.fusion import noise_scale
from semloc_jax.fusion.clock import BELIEFS, CameraTimeLog, unknown_offset
from semloc_jax.fusion.measurements import FusedPose, PoseMeasurement
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.fusion.window import SlidingWindow
from semloc_jax.localization import following, health, map_faults
from semloc_jax.localization.following import FrameReport
from semloc_jax.localization.frame_alignment import Alignment, FrameAligner
from semloc_jax.localization.initialization import no_fixes
from semloc_jax.localization.learning import with_learned
from semloc_jax.localization.track_state import FrameFeatures, TrackerState
from semloc_jax.structs import SolveStatus

SPEED_MPS, SIGMAS = 10.0, np.array([0.05, 0.02, 0.03, 0.01, 0.01, 0.002])


def at(x_m: float, left_m: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:2, 3] = x_m, left_m
    return T


def seen_at(time_s: float, T: np.ndarray) -> FrameReport:
    measured = PoseMeasurement(time_s, T, np.diag(SIGMAS**2))
    numbers = (0.1, 1.0, 0.9, 3.0, 900.0, 0.0)
    found = Alignment(measured, SolveStatus.CONVERGED, *numbers, np.ones(6), np.zeros(0), np.zeros(0))
    return FrameReport(found, False, False, (), None, np.zeros(6), np.diag(SIGMAS**2))


def started(num_elements: int = 3) -> TrackerState:
    zero = np.float64(0.0)
    state = (zero, np.int64(0), (), (), zero, no_fixes(), map_faults.full_trust(num_elements), health.no_counts())
    more = (np.zeros(3), np.uint32(0), zero, noise_scale.unknown_noise(), unknown_offset(BELIEFS))
    return TrackerState(*state, *more)


def test_poses_are_compared_over_the_way_between_them_though_frames_between_were_refused():
    """Exact poses at every third frame: they say that errors are smaller than believed, not nine times larger."""
    log = MotionLog()
    for k in range(200):
        log.add_wheels(0.02 * k, SPEED_MPS, 0.0)
    state = started()
    motion = CameraTimeLog(log, state.clock)
    for k in range(1, 31):
        if k % 3:
            continue
        before_s, now_s = 0.1 * (k - 1), 0.1 * k
        before, fused = (
            FusedPose(t, at(SPEED_MPS * t), 1e-4 * np.eye(6), 1.0, 0.0, np.zeros(2)) for t in (before_s, now_s)
        )
        view = seen_at(now_s, at(SPEED_MPS * now_s))
        state = with_learned(state._replace(time_s=np.float64(now_s)), view, fused, motion, before, 1.0)
    assert noise_scale.factors(state.noise, noise_scale.BELIEFS)[0] == pytest.approx(0.53, abs=0.08)


@pytest.mark.parametrize(("off_m", "is_taken"), [(0.03, True), (0.6, False)])
def test_a_first_pose_is_as_sure_as_any_later_one_where_a_second_solve_ends_there(monkeypatch, off_m, is_taken):
    """Its variance is that of one pose of a series; a search that ended elsewhere keeps the four times larger one."""
    first = PoseMeasurement(0.0, at(0.0), 4.0 * np.diag(SIGMAS**2) + 0.05**2 * np.diag([1, 1, 1, 0.02, 0.02, 0.02]))
    monkeypatch.setattr(following, "seen", lambda *_: seen_at(0.0, at(0.0, off_m)))
    known = (lambda rows: rows, np.zeros(3), np.ones(()))
    # Neither map nor frame is asked: what a solve finds is given above.
    aligner, frame = object.__new__(FrameAligner), tuple.__new__(FrameFeatures, [None] * len(FrameFeatures._fields))
    parts = (SlidingWindow(), aligner, frame, known, noise_scale.unknown_noise(), health.HealthConfig())
    found = following.solved_again(first, *parts)
    assert found.T_map_base[1, 3] == (off_m if is_taken else 0.0)
    sigma_m = float(np.sqrt(found.covariance[1, 1]))
    assert sigma_m == pytest.approx(0.0186 if is_taken else np.sqrt(first.covariance[1, 1]), rel=0.01)
