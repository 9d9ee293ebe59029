"""Sliding window: marginalisation is batch least squares, consistent, standing, outvoting, fixes, bit-for-bit state."""

import jax
import numpy as np
import pytest
from scipy.stats import chi2

from semloc_jax.fusion.measurements import SensorBeliefs
from semloc_jax.fusion.pose_factors import GraphConfig
from semloc_jax.fusion.window import SlidingWindow, WindowConfig
from semloc_jax.geometry import rigid
from tests.fusion import fusion_drive as drive

NO_KERNEL = GraphConfig(pose_threshold=1e6, fix_threshold=1e6)
NO_WALK = SensorBeliefs(scale_walk=0.0, gyro_bias_walk_degps=0.0, gnss_offset_walk_m=0.0)


def along(x):
    return rigid.exp(np.array([x, 0, 0, 0, 0, 0]))


def follow(fusion, num, rng=None, scale=1.0, bias=0.0):
    poses = drive.true_poses(num)
    states = [fusion.start(drive.measured(0, poses[0], rng))]
    for k in range(num):
        calibration = fusion.pose(states[-1]).calibration
        state = fusion.predict(states[-1], drive.increment(k, rng, calibration, scale, bias))
        state, _ = fusion.correct(state, drive.measured(k + 1, poses[k + 1], rng))
        states.append(state)
    return states, poses


def straight(fusion, measured_m):
    """Fused states of a straight drive of 1 m a step with an odometer that is to be calibrated."""
    state = fusion.start(drive.measured(0, along(measured_m[0])))
    for k, x in enumerate(measured_m[1:]):
        twist = np.array([1.0, 0, 0, 0, 0, 0])
        state = fusion.predict(state, drive.increment(k, None, fusion.pose(state).calibration, twist=twist))
        state, innovation = fusion.correct(state, drive.measured(k + 1, along(x)))
        assert innovation.accepted
    return state


def batch(measured_m):
    """Position at the end, scale and their variances from all measurements at once."""
    num = len(measured_m)
    unknown = np.eye(num + 1)
    rows = [*unknown[:num] / drive.POSE_SIGMA[0]]
    rows += [(unknown[k + 1] - unknown[k] - unknown[-1]) / drive.MOTION_SIGMA[0] for k in range(num - 1)]
    rows.append(unknown[-1] / NO_WALK.scale_sigma)
    right = [*np.array(measured_m) / drive.POSE_SIGMA[0], *np.zeros(num - 1), 1.0 / NO_WALK.scale_sigma]
    A = np.array(rows)
    best, covariance = np.linalg.lstsq(A, np.array(right))[0], np.linalg.inv(A.T @ A)
    return best[num - 1], best[-1], covariance[num - 1, num - 1], covariance[-1, -1]


def test_marginalisation_loses_nothing_on_a_straight_drive():
    """A window of 6 after 30 frames is least squares over all 30; one that drops knows less of the scale."""
    rng = np.random.default_rng(3)
    measured_m = 1.01 * np.arange(30) + rng.normal(size=30) * drive.POSE_SIGMA[0]
    kept = SlidingWindow(WindowConfig(6, NO_WALK, NO_KERNEL))
    dropped = SlidingWindow(WindowConfig(6, NO_WALK, NO_KERNEL, marginalise=False))
    position, scale, position_variance, scale_variance = batch(measured_m)
    state = straight(kept, measured_m)
    assert kept.pose(state).T_map_base[0, 3] == pytest.approx(position, abs=1e-6)
    assert kept.pose(state).odometer_scale == pytest.approx(scale, abs=1e-6)
    assert state.covariance[0, 0] == pytest.approx(position_variance, rel=1e-5)
    assert state.covariance[6, 6] == pytest.approx(scale_variance, rel=1e-5)
    poor = straight(dropped, measured_m)
    assert poor.covariance[6, 6] > 10 * scale_variance and poor.covariance[0, 0] > 1.1 * position_variance


@pytest.mark.slow
def test_errors_are_as_large_as_stated_and_smaller_than_measured():
    fusion, squares, along_m = SlidingWindow(WindowConfig(6)), [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        states, poses = follow(fusion, 40, rng, 1.0 + 0.02 * rng.normal(), np.deg2rad(0.2) * rng.normal())
        for k in (4, 20, 40):
            found = fusion.pose(states[k])
            e = drive.error(found.T_map_base, poses[k])
            squares.append(e @ np.linalg.solve(found.covariance, e))
        along_m += [abs(drive.error(fusion.pose(states[k]).T_map_base, poses[k])[0]) for k in range(20, 41)]
    low, high = chi2.ppf([0.005, 0.995], 6 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high
    assert np.mean(along_m) < 0.05  # single measurements: 0.10 m sqrt(2 / pi) = 0.08 m


def test_a_standing_vehicle_keeps_its_window():
    """32 frames at one place with one error of 8 cm: no state is given up, nothing is gained from repetition."""
    fusion = SlidingWindow(WindowConfig(6))
    states, poses = follow(fusion, 8)
    state, wrong = states[-1], poses[8] @ along(0.08)
    before = fusion.pose(state)
    for k in range(8, 40):
        state = fusion.predict(state, drive.increment(k, twist=np.zeros(6)))
        state, _ = fusion.correct(state, drive.measured(k + 1, wrong))
    after = fusion.pose(state)
    assert int(state.num) == 6 and state.time_s[0] == pytest.approx(states[-1].time_s[0])
    assert after.covariance[0, 0] > 0.5 * before.covariance[0, 0]
    assert abs(drive.error(after.T_map_base, poses[8])[0]) < 0.05


def test_one_wrong_pose_is_outvoted():
    """A pose 5 sigma aside in each direction passes no gate; at 1.9 sigma it does, and later frames outvote it."""
    fusion = SlidingWindow(WindowConfig(6))
    states, poses = follow(fusion, 12)
    aside = poses[12] @ rigid.exp(5.0 * drive.POSE_SIGMA)
    state, innovation = fusion.correct(states[-1], drive.measured(12, aside))
    assert not innovation.accepted and state is states[-1]
    state = fusion.predict(states[-1], drive.increment(12))
    state, innovation = fusion.correct(
        state, drive.measured(13, drive.true_poses(13)[13] @ rigid.exp(1.9 * drive.POSE_SIGMA))
    )
    assert innovation.accepted
    pulled = drive.error(fusion.pose(state).T_map_base, drive.true_poses(13)[13])
    poses = drive.true_poses(24)
    for k in range(13, 24):
        state = fusion.predict(state, drive.increment(k))
        state, _ = fusion.correct(state, drive.measured(k + 1, poses[k + 1]))
    left = drive.error(fusion.pose(state).T_map_base, poses[24])
    assert np.linalg.norm(left[:3]) < 0.2 * np.linalg.norm(pulled[:3]) < 0.2 * 0.1


def test_sensors_and_offset_of_the_fixes_are_learned_and_carry_the_pose():
    """10 s with poses, scale 2 %, bias 0.17 deg/s, fixes 2.5 m off; then 6 s with fixes only: within 30 cm."""
    rng, fusion, offset = np.random.default_rng(7), SlidingWindow(WindowConfig(6)), (2.0, -1.5)
    poses = drive.true_poses(160)
    state = fusion.start(drive.measured(0, poses[0], rng))
    for k in range(160):
        state = fusion.predict(state, drive.increment(k, rng, fusion.pose(state).calibration, 1.02, 0.003))
        if k < 100:
            state, _ = fusion.correct(state, drive.measured(k + 1, poses[k + 1], rng))
        if k % 2:
            state, innovation = fusion.correct_gnss(state, drive.fix(k + 1, poses[k + 1], offset, rng))
            assert innovation.accepted
    found = fusion.pose(state)
    assert found.odometer_scale == pytest.approx(1.02, abs=0.003)
    assert found.gyro_bias_radps == pytest.approx(0.003, abs=0.001)
    assert found.gnss_offset_m == pytest.approx(offset, abs=0.3)
    off = drive.error(found.T_map_base, poses[160])
    assert np.linalg.norm(off[:2]) < 0.3 and np.all(np.abs(off) < 3.5 * np.sqrt(np.diag(found.covariance)))
    same, innovation = fusion.correct_gnss(state, drive.fix(160, poses[160], (22.0, 0.0)))
    assert not innovation.accepted and same is state


def test_a_first_fix_that_is_astray_does_not_shut_out_the_right_ones():
    drive.check_a_first_fix_that_is_astray(SlidingWindow(WindowConfig(6)))


def test_a_body_that_travels_askew_is_no_heading_error():
    """0.5 deg between base x and the way: poses of 0.06 deg are kept, not turned into the way; the state is found."""
    travel, fusion = np.deg2rad(0.5), SlidingWindow(WindowConfig(6))
    rng, poses = np.random.default_rng(4), drive.true_poses(120, travel=travel)
    state, off_deg = fusion.start(drive.measured(0, poses[0], rng)), []
    for k in range(120):
        state = fusion.predict(state, drive.increment(k, rng, fusion.pose(state).calibration))
        state, innovation = fusion.correct(state, drive.measured(k + 1, poses[k + 1], rng))
        assert innovation.accepted
        off_deg.append(np.degrees(drive.error(fusion.pose(state).T_map_base, poses[k + 1])[5]))
    assert abs(np.mean(off_deg[60:])) < 0.02
    assert fusion.pose(state).travel_rad == pytest.approx(travel, abs=np.deg2rad(0.05))


def test_between_frames_the_pose_follows_the_odometry():
    fusion = SlidingWindow(WindowConfig(6))
    states, poses = follow(fusion, 10)
    whole = drive.increment(10)
    half = whole._replace(T_from_to=rigid.exp(0.5 * drive.true_twist(10)), covariance=0.5 * whole.covariance)
    first = half._replace(to_s=whole.from_s + 0.05, jacobian=0.5 * whole.jacobian)
    second = half._replace(from_s=first.to_s, jacobian=0.5 * whole.jacobian)
    state = fusion.predict(states[-1], first)
    assert fusion.pose(state).time_s == pytest.approx(1.05)
    assert np.allclose(fusion.pose(state).T_map_base, poses[10] @ half.T_from_to, atol=1e-3)
    split, direct = fusion.pose(fusion.predict(state, second)), fusion.pose(fusion.predict(states[-1], whole))
    assert np.allclose(split.T_map_base, direct.T_map_base, atol=1e-6)
    assert np.allclose(np.diag(split.covariance), np.diag(direct.covariance), rtol=0.02)


def test_without_any_sensor_the_motion_of_before_goes_on():
    fusion = SlidingWindow(WindowConfig(6))
    states, _ = follow(fusion, 20)
    state = states[-1]
    for k in range(20, 30):
        state = fusion.predict(state, drive.missing(k))
    off = drive.error(fusion.pose(state).T_map_base, drive.true_poses(30)[30])
    assert np.linalg.norm(off[:3]) < 1.5  # of 10 m
    assert np.all(np.abs(off) < 3 * np.sqrt(np.diag(fusion.pose(state).covariance)))


def test_state_is_saved_and_restored_bit_for_bit(tmp_path):
    fusion = SlidingWindow(WindowConfig(6))
    states, poses = follow(fusion, 14, np.random.default_rng(9))
    leaves, tree = jax.tree.flatten(states[9])
    np.savez(tmp_path / "state.npz", *leaves)
    with np.load(tmp_path / "state.npz") as saved:
        restored = jax.tree.unflatten(tree, [saved[f"arr_{k}"] for k in range(len(leaves))])
    ends = []
    for state in (states[9], restored):
        rng = np.random.default_rng(10)
        for k in range(9, 14):
            state = fusion.predict(state, drive.increment(k, rng, fusion.pose(state).calibration))
            state, _ = fusion.correct(state, drive.measured(k + 1, poses[k + 1], rng))
            state, _ = fusion.correct_gnss(state, drive.fix(k + 1, poses[k + 1], rng=rng))
        ends.append(state)
    for one, other in zip(*map(jax.tree.leaves, ends), strict=True):
        assert np.array_equal(one, other)
