"""Kalman fusion: equal to batch least squares, consistent, calibrates sensors, refuses outliers, saves bit for bit."""

import numpy as np
import pytest
from scipy.stats import chi2

from semloc_jax.errors import SemlocError
from semloc_jax.fusion.kalman import KalmanConfig, KalmanFusion
from semloc_jax.fusion.measurements import SensorBeliefs, SingleFrameFusion
from semloc_jax.geometry import rigid
from tests.fusion import fusion_drive as drive


def follow(fusion, num, rng=None, scale=1.0, bias=0.0, corrected=lambda k: True):
    """States after every step of the drive, and the true poses."""
    poses = drive.true_poses(num)
    state = fusion.start(drive.measured(0, poses[0], rng))
    states = [state]
    for k in range(num):
        calibration = fusion.pose(state).calibration
        state = fusion.predict(state, drive.increment(k, rng, calibration, scale, bias))
        if corrected(k + 1):
            state, _ = fusion.correct(state, drive.measured(k + 1, poses[k + 1], rng))
        states.append(state)
    return states, poses


def test_straight_drive_is_batch_least_squares():
    """Position and scale of a straight drive against the normal equations of all measurements at once."""
    rng, num = np.random.default_rng(3), 12
    fusion = KalmanFusion(KalmanConfig(SensorBeliefs(scale_walk=0.0)))
    twist = np.array([1.0, 0, 0, 0, 0, 0])
    states_m = rng.normal(size=num + 1) * drive.POSE_SIGMA[0] + 1.01 * np.arange(num + 1)
    line = lambda x: rigid.exp(np.array([x, 0, 0, 0, 0, 0]))  # noqa: E731
    state = fusion.start(drive.measured(0, line(states_m[0])))
    rows, values, sigmas = [], [], []
    unknown = np.eye(num + 2)
    for k in range(num + 1):
        rows.append(unknown[k])
        values.append(states_m[k])
        sigmas.append(drive.POSE_SIGMA[0])
        if k == num:
            break
        rows.append(unknown[k + 1] - unknown[k] - unknown[-1])
        values.append(0.0)
        sigmas.append(drive.MOTION_SIGMA[0])
        increment = drive.increment(k, None, fusion.pose(state).calibration, twist=twist)
        state = fusion.predict(state, increment)
        state, innovation = fusion.correct(state, drive.measured(k + 1, line(states_m[k + 1])))
        assert innovation.accepted
    rows.append(unknown[-1])
    values.append(1.0)
    sigmas.append(SensorBeliefs().scale_sigma)
    A, b = np.array(rows) / np.array(sigmas)[:, None], np.array(values) / np.array(sigmas)
    batch, covariance = np.linalg.lstsq(A, b)[0], np.linalg.inv(A.T @ A)
    found = fusion.pose(state)
    assert found.T_map_base[0, 3] == pytest.approx(batch[num], abs=1e-6)
    assert found.odometer_scale == pytest.approx(batch[-1], abs=1e-6)
    assert found.covariance[0, 0] == pytest.approx(covariance[num, num], rel=1e-6)
    assert state.covariance[6, 6] == pytest.approx(covariance[-1, -1], rel=1e-6)


def test_errors_are_as_large_as_stated():
    """Normalised squared error over 12 noisy drives, at three times: inside the 99 % band of chi-square with 6 dof."""
    squares = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        scale, bias = 1.0 + 0.02 * rng.normal(), np.deg2rad(0.2) * rng.normal()
        states, poses = follow(KalmanFusion(), 60, rng, scale, bias)
        for k in (5, 30, 60):
            found = KalmanFusion().pose(states[k])
            e = drive.error(found.T_map_base, poses[k])
            squares.append(e @ np.linalg.solve(found.covariance, e))
    low, high = chi2.ppf([0.005, 0.995], 6 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high


def test_filter_is_better_than_single_frames_and_learns_the_sensors():
    states, poses = follow(KalmanFusion(), 200, np.random.default_rng(5), scale=1.02, bias=0.003)
    single, _ = follow(SingleFrameFusion(), 200, np.random.default_rng(5), scale=1.02, bias=0.003)
    along = [
        np.mean([abs(drive.error(s.T_map_base, T)[0]) for s, T in zip(run[50:], poses[50:], strict=True)])
        for run in (states, single)
    ]
    assert along[1] == pytest.approx(0.08, abs=0.015)  # 0.10 m sqrt(2 / pi)
    assert along[0] < 0.5 * along[1]
    found = KalmanFusion().pose(states[-1])
    assert found.odometer_scale == pytest.approx(1.02, abs=0.003)
    assert found.gyro_bias_radps == pytest.approx(0.003, abs=0.001)


def test_dead_reckoning_after_learning_drifts_less_than_without():
    """No pose for 10 s: the learned scale and bias hold the vehicle within its stated 3 sigma."""
    seen = lambda k: k <= 100  # noqa: E731
    states, poses = follow(KalmanFusion(), 200, None, 1.02, 0.003, seen)
    single, _ = follow(SingleFrameFusion(), 200, None, 1.02, 0.003, seen)
    found = KalmanFusion().pose(states[-1])
    off = drive.error(found.T_map_base, poses[-1])
    assert np.all(np.abs(off) <= 3 * np.sqrt(np.diag(found.covariance)))
    assert np.linalg.norm(off[:3]) < 0.3 < 2.0 < np.linalg.norm(drive.error(single[-1].T_map_base, poses[-1])[:3])


def test_offset_of_the_fixes_is_learned_and_carries_the_pose_when_masks_are_missing():
    rng, fusion = np.random.default_rng(7), KalmanFusion()
    states, poses = follow(fusion, 100, rng)
    state, offset = states[0], (2.0, -1.5)
    for k in range(100):
        state = fusion.predict(state, drive.increment(k, rng))
        state, _ = fusion.correct(state, drive.measured(k + 1, poses[k + 1], rng))
        state, innovation = fusion.correct_gnss(state, drive.fix(k + 1, poses[k + 1], offset, rng))
        assert innovation.dof == 2
    assert fusion.pose(state).gnss_offset_m == pytest.approx(offset, abs=0.25)
    before = state
    state, innovation = fusion.correct_gnss(state, drive.fix(100, poses[100], (22.0, 0.0)))
    assert not innovation.accepted and innovation.chi2 > 100.0 and state is before


def test_a_first_fix_that_is_astray_does_not_shut_out_the_right_ones():
    drive.check_a_first_fix_that_is_astray(KalmanFusion())


def test_jumps_are_refused_and_the_state_is_kept():
    states, poses = follow(KalmanFusion(), 30, np.random.default_rng(8))
    fusion = KalmanFusion()
    aside = poses[30] @ rigid.exp(np.array([0.0, 3.5, 0, 0, 0, 0]))
    state, innovation = fusion.correct(states[-1], drive.measured(30, aside))
    assert not innovation.accepted and state is states[-1]
    # So vague a pose passes the chi-square test; the mean motion still says that nobody moves aside by 3.5 m.
    vague = drive.measured(30, aside)._replace(covariance=9.0 * np.eye(6))
    state, innovation = fusion.correct(states[-1], vague)
    assert innovation.chi2 < chi2.ppf(0.999, 6) and not innovation.accepted and state is states[-1]


def test_the_gate_opens_again_while_nothing_is_accepted():
    """A filter that is 0.6 m beside the road refuses good poses at first, and takes them within 10 s of driving."""
    fusion, poses = KalmanFusion(), drive.true_poses(100)
    wrong = poses[0] @ rigid.exp(np.array([0.0, 0.6, 0, 0, 0, 0]))
    state, accepted = fusion.start(drive.measured(0, wrong)), []
    for k in range(100):
        state = fusion.predict(state, drive.increment(k))
        state, innovation = fusion.correct(state, drive.measured(k + 1, poses[k + 1]))
        accepted.append(innovation.accepted)
    assert not accepted[0] and accepted[-1]
    assert np.linalg.norm(drive.error(state.T_map_base, poses[-1])[:3]) < 0.05


def test_without_any_sensor_the_mean_motion_goes_on():
    fusion = KalmanFusion()
    poses = drive.true_poses(80)
    state = fusion.start(drive.measured(0, poses[0]))
    for k in range(80):
        state = fusion.predict(state, drive.missing(k))
        if k < 60:
            state, innovation = fusion.correct(state, drive.measured(k + 1, poses[k + 1]))
            assert innovation.accepted
    off = drive.error(state.T_map_base, poses[80])
    assert np.linalg.norm(off[:2]) < 5.0  # of 20 m driven blind, into a bend
    assert np.all(np.abs(off) < 3 * np.sqrt(np.diag(state.covariance)[:6]))


@pytest.mark.parametrize("fusion", [KalmanFusion(), SingleFrameFusion()], ids=["kalman", "single"])
def test_state_is_saved_and_restored_bit_for_bit(fusion, tmp_path):
    states, poses = follow(fusion, 20, np.random.default_rng(9))
    np.savez(tmp_path / "state.npz", **states[10]._asdict())
    with np.load(tmp_path / "state.npz") as saved:
        restored = type(states[10])(**saved)
    ends = []
    for state in (states[10], restored):
        rng = np.random.default_rng(10)
        for k in range(10, 20):
            state = fusion.predict(state, drive.increment(k, rng, fusion.pose(state).calibration))
            state, _ = fusion.correct(state, drive.measured(k + 1, poses[k + 1], rng))
            state, _ = fusion.correct_gnss(state, drive.fix(k + 1, poses[k + 1], rng=rng))
        ends.append(state)
    for one, other in zip(*ends, strict=True):
        assert np.array_equal(one, other, equal_nan=True)


@pytest.mark.parametrize("fusion", [KalmanFusion(), SingleFrameFusion()], ids=["kalman", "single"])
def test_input_of_another_time_is_refused(fusion):
    state = fusion.start(drive.measured(0, drive.START))
    with pytest.raises(SemlocError, match="predict up to it first"):
        fusion.correct(state, drive.measured(1, drive.START))
    with pytest.raises(SemlocError, match="increment at"):
        fusion.predict(state, drive.increment(3))
