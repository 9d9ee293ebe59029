"""A winding drive with known errors, as poses, motion increments and fixes: what every fusion is tried on."""

import numpy as np

from semloc_jax.fusion.measurements import GnssMeasurement, PoseMeasurement
from semloc_jax.fusion.prediction import Calibration, MotionIncrement, MotionQuality
from semloc_jax.geometry import rigid

STEP_S = 0.1
POSE_SIGMA = np.array([0.10, 0.03, 0.02, 0.002, 0.002, 0.001])
MOTION_SIGMA = np.array([0.01, 0.005, 0.005, 0.0005, 0.0005, 0.0003])
START = rigid.exp(np.array([300.0, -200.0, 10.0, 0.01, -0.02, 1.0]))


def true_twist(k):
    """Motion of step k: (v, omega) x 0.1 s."""
    return STEP_S * np.array([10.0 + np.sin(0.2 * k), 0.0, 0.0, 0.01, -0.01, 0.2 * np.sin(0.1 * k)])


def true_poses(num, start=START, travel=0.0):
    """Poses of a vehicle that moves in the direction `travel` [rad] against its x axis."""
    poses = [start]
    for k in range(num):
        poses.append(poses[-1] @ rigid.exp(along(travel) * true_twist(k)[0] + true_twist(k) * [0, 1, 1, 1, 1, 1]))
    return poses


def along(travel):
    """Tangent of one metre of motion in a direction."""
    return np.array([np.cos(travel), np.sin(travel), 0.0, 0.0, 0.0, 0.0])


def increment(k, rng=None, calibration=None, scale=1.0, bias=0.0, twist=None):
    """Increment of step k as sensors with errors and an assumed calibration give it, noise included."""
    calibration = calibration or Calibration()
    twist = (true_twist(k) if twist is None else twist).copy()
    driven = twist[0] / scale
    ahead, across = along(calibration.travel_rad), along(calibration.travel_rad + np.pi / 2)
    twist = twist * [0, 1, 1, 1, 1, 1] + driven * calibration.odometer_scale * ahead
    twist[5] += STEP_S * (bias - calibration.gyro_bias_radps)
    chart = rigid.right_jacobian(twist)
    columns = chart @ ahead * driven, -chart[:, 5] * STEP_S, chart @ across * driven * calibration.odometer_scale
    jacobian = np.column_stack(columns)
    noise = rng.normal(size=6) * MOTION_SIGMA if rng is not None else np.zeros(6)
    T = rigid.exp(twist) @ rigid.exp(-noise)
    return MotionIncrement(
        T, np.diag(MOTION_SIGMA**2), k * STEP_S, (k + 1) * STEP_S, jacobian, MotionQuality.OK, calibration
    )


def missing(k):
    covariance = np.diag(np.array([1.5, 0.2, 0.2, 0.002, 0.002, 0.03]) ** 2)
    jacobian = np.zeros((6, 3))
    return MotionIncrement(np.eye(4), covariance, k * STEP_S, (k + 1) * STEP_S, jacobian, MotionQuality.MISSING)


def measured(k, T, rng=None, sigma=POSE_SIGMA):
    """Pose measurement at step k around T."""
    noise = rng.normal(size=6) * sigma if rng is not None else np.zeros(6)
    return PoseMeasurement(k * STEP_S, T @ rigid.exp(noise), np.diag(sigma**2))


def fix(k, T, offset=(0.0, 0.0), rng=None, sigma=0.5):
    noise = rng.normal(size=3) * sigma if rng is not None else np.zeros(3)
    return GnssMeasurement(k * STEP_S, T[:3, 3] + [*offset, 0.0] + noise, np.full(3, sigma))


def error(T_estimate, T_true):
    """Right tangent from estimate to truth."""
    return rigid.log(rigid.inverse(T_estimate) @ T_true)


def check_a_first_fix_that_is_astray(fusion):
    """The first fix is 6.8 m off and taken, since nothing is known of the satellites; those after it, which fit the
    pose, outvote it within 3 s, and another one that is astray is refused."""
    rng, poses = np.random.default_rng(3), true_poses(30)
    state = fusion.start(measured(0, poses[0], rng))
    for k in range(30):
        state = fusion.predict(state, increment(k, rng))
        state, _ = fusion.correct(state, measured(k + 1, poses[k + 1], rng))
        offset = (-4.4, 5.1) if k == 0 else (0.5, -0.6)
        state, innovation = fusion.correct_gnss(state, fix(k + 1, poses[k + 1], offset, rng))
        assert innovation.accepted
    assert np.hypot(*(fusion.pose(state).gnss_offset_m - [0.5, -0.6])) < 1.5
    assert not fusion.correct_gnss(state, fix(30, poses[30], (-4.4, 5.1)))[1].accepted
