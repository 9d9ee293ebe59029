"""Errors in the vehicle frame: which axis is which, what the statistics mean, agreement with evo."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import ErrorLimit, Trajectory, evaluate, pose_errors, within


def pose(x=0.0, y=0.0, z=0.0, yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    T[:3, 3] = [x, y, z]
    return T


def random_trajectory(num_poses, seed):
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (num_poses, 1, 1))
    T[:, :3, :3] = Rotation.random(num_poses, random_state=seed).as_matrix()
    T[:, :3, 3] = rng.normal(size=(num_poses, 3)) * 50.0
    return Trajectory(np.arange(num_poses) * 0.1, T)


angle = st.floats(-80.0, 80.0)
offset = st.floats(-20.0, 20.0)


@settings(max_examples=80, deadline=None)
@given(yaw=st.floats(-180.0, 180.0), tilt=st.tuples(angle, angle), ahead=offset, left=offset, up=offset)
def test_lateral_and_longitudinal_are_not_swapped(yaw, tilt, ahead, left, up):
    T_ref = pose(100.0, -40.0, 3.0, yaw, *tilt)
    T_est = T_ref @ pose(ahead, left, up)
    errors = pose_errors(T_est, T_ref)
    assert errors["longitudinal_m"] == pytest.approx(ahead, abs=1e-9)
    assert errors["lateral_m"] == pytest.approx(left, abs=1e-9)
    assert errors["height_m"] == pytest.approx(up, abs=1e-9)


def test_a_vehicle_heading_north_sees_an_estimate_in_the_east_on_its_right():
    errors = pose_errors(pose(1.0, 10.0, yaw_deg=90.0), pose(0.0, 10.0, yaw_deg=90.0))
    assert errors["lateral_m"] == pytest.approx(-1.0)
    assert errors["longitudinal_m"] == pytest.approx(0.0, abs=1e-12)


@settings(max_examples=50, deadline=None)
@given(yaw=angle, pitch=angle, roll=angle)
def test_angles_are_those_of_the_vehicle(yaw, pitch, roll):
    T_ref = pose(5.0, 1.0, 0.0, 170.0, 3.0, -2.0)
    errors = pose_errors(T_ref @ pose(0, 0, 0, yaw, pitch, roll), T_ref)
    found = [errors["heading_deg"], errors["pitch_deg"], errors["roll_deg"]]
    np.testing.assert_allclose(found, [yaw, pitch, roll], atol=1e-7)


def test_heading_error_wraps():
    errors = pose_errors(pose(yaw_deg=-179.0), pose(yaw_deg=179.0))
    assert errors["heading_deg"] == pytest.approx(2.0)


def test_translation_and_rotation_agree_with_evo():
    evo_metrics = pytest.importorskip("evo.core.metrics")
    evo_trajectory = pytest.importorskip("evo.core.trajectory")
    reference, estimate = random_trajectory(60, 1), random_trajectory(60, 2)
    as_evo = [
        evo_trajectory.PoseTrajectory3D(poses_se3=list(t.T_map_base), timestamps=t.time_s)
        for t in (reference, estimate)
    ]
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data(tuple(as_evo))
    found = {metric.key: metric.value for metric in evaluate(estimate, reference)}
    for statistic in ("rmse", "mean", "median", "max"):
        expected = ape.get_statistic(evo_metrics.StatisticsType[statistic])
        assert found[f"translation.{statistic}"] == pytest.approx(expected, rel=1e-9)

    angle_ape = evo_metrics.APE(evo_metrics.PoseRelation.rotation_angle_deg)
    angle_ape.process_data(tuple(as_evo))
    errors = pose_errors(estimate.T_map_base, reference.T_map_base)
    angles = np.column_stack([errors["heading_deg"], errors["pitch_deg"], errors["roll_deg"]])
    magnitude = Rotation.from_euler("ZYX", angles, degrees=True).magnitude()
    np.testing.assert_allclose(np.degrees(magnitude), angle_ape.error, atol=1e-6)


def test_statistics_and_shares_of_a_known_case():
    reference = Trajectory(np.arange(4.0), np.stack([pose(x, 0.0) for x in range(4)]))
    lateral = [0.1, -0.2, 0.4, -0.9]
    estimate = Trajectory(np.arange(4.0), np.stack([pose(x, y) for x, y in enumerate(lateral)]))
    found = {metric.key: metric.value for metric in evaluate(estimate, reference)}
    assert found["lateral.mean"] == pytest.approx(0.4)
    assert found["lateral.bias"] == pytest.approx(-0.15)
    assert found["lateral.rmse"] == pytest.approx(np.sqrt(1.02 / 4))
    assert found["lateral.median"] == pytest.approx(0.3)
    assert found["lateral.max"] == pytest.approx(0.9)
    assert found["inside.local_street"] == 0.5
    assert found["inside.freeway"] == 0.75
    assert found["available.0.5m"] == 0.75
    assert found["available.1m"] == 1.0
    assert found["recall.0.3m_0.5m_0.5deg"] == 0.5


def test_silence_and_nan_count_as_missed():
    reference = Trajectory(np.arange(4.0), np.stack([np.eye(4)] * 4))
    T = np.stack([np.eye(4)] * 3)
    T[2, 0, 3] = np.nan
    found = {metric.key: metric.value for metric in evaluate(Trajectory(np.arange(3.0), T), reference)}
    assert found["frames.estimated"] == 2
    assert found["available.1m"] == 0.5
    assert found["recall.5m_5deg"] == 0.5


def test_within_needs_all_three():
    limit = ErrorLimit("x", 0.3, 0.5, 1.0)
    T_est = np.stack([pose(0.49, 0.29, yaw_deg=0.9), pose(0.0, 0.31), pose(0.51), pose(yaw_deg=-1.1)])
    T_ref = np.stack([np.eye(4)] * 4)
    assert within(pose_errors(T_est, T_ref), limit).tolist() == [True, False, False, False]


def test_two_clocks_are_named():
    reference = Trajectory(np.arange(3.0), np.stack([np.eye(4)] * 3))
    estimate = Trajectory(np.arange(3.0) + 1000.0, np.stack([np.eye(4)] * 3))
    with pytest.raises(SemlocError, match="same clock"):
        evaluate(estimate, reference)
