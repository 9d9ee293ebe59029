"""The way of a drive by its own sensors: biases and scale found, without gyroscope, without wheels, real drives."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Drive, Frame, read_drive
from semloc_jax.datasets.sensors import Imu, WheelOdometry
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.geometry import rigid
from semloc_jax.mapping.chain import drive_chain

SCALE, BIAS = 1.03, np.array([0.004, -0.003, 0.002])
"""True speed over wheel speed; gyro bias [rad/s]."""
END_S = 120.0


def speed(t):
    """Stands from 40 s to 46 s."""
    return 5.0 * np.clip(np.abs(t - 43.0) - 3.0, 0.0, 1.0)


def yaw_rate(t):
    return 0.25 * np.sin(0.15 * t) * (speed(t) > 0.0)


def sensors(seed=0):
    """Wheels and inertial sensor of a level winding drive, with errors; and the true poses at frame times."""
    rng = np.random.default_rng(seed)
    t, fine = np.arange(0.0, END_S, 0.02), np.linspace(0.0, END_S, 60001)
    wheels = WheelOdometry(t, speed(t) / SCALE, 0.98 * yaw_rate(t) + 0.004 * rng.normal(size=len(t)))
    acceleration = (speed(t + 0.01) - speed(t - 0.01)) / 0.02
    accel = np.stack([acceleration, speed(t) * yaw_rate(t), np.full(len(t), 9.81)], axis=1)
    gyro = np.stack([0 * t, 0 * t, yaw_rate(t)], axis=1) + BIAS
    imu = Imu(t, gyro + 0.002 * rng.normal(size=gyro.shape), accel + 0.05 * rng.normal(size=accel.shape))
    yaw = np.concatenate([[0.0], np.cumsum(yaw_rate(fine[:-1] + 0.001) * 0.002)])
    step = speed(fine[:-1] + 0.001) * 0.002
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    x, y = (np.concatenate([[0.0], np.cumsum(step * part)]) for part in (np.cos(middle), np.sin(middle)))
    poses = np.array([rigid.planar_pose(*row) for row in np.column_stack([x, y, yaw])[::500]])
    return wheels, imu, Trajectory(fine[::500], poses)


def drive(odometry, imu, num=110):
    rig = Rig([PinholeCamera(400.0, 400.0, 320.0, 240.0, 640, 480)], np.eye(4)[None], ["front"])
    frames = tuple(Frame(k, f"{k:06d}", 1.0 + k, "", rig, {}) for k in range(num))
    return Drive("made", Path("."), frames, rig, odometry=odometry, imu=imu)


def errors(chain, truth):
    """Horizontal errors [m] and heading errors [deg] after the first poses are laid on each other."""
    true = truth.interpolate(chain.times_s)
    off = rigid.inverse(true) @ (true[0] @ rigid.inverse(chain.Ts_odom_base[0]) @ chain.Ts_odom_base)
    return np.hypot(*off[:, :2, 3].T), np.degrees(np.abs(np.arctan2(off[:, 1, 0], off[:, 0, 0])))


def test_scale_and_biases_are_found_from_curves_and_standstill():
    wheels, imu, truth = sensors()
    chain = drive_chain(drive(wheels, imu))
    scale, sigma = chain.calibration[0], chain.calibration_sigma[0]
    assert abs(scale - SCALE) < 3.0 * sigma < 0.03
    # 0.04 deg/s is 2.4 deg a minute where the bias left alone would be 6.9.
    np.testing.assert_allclose(np.degrees(chain.gyro_bias_radps[42]), np.degrees(BIAS), atol=0.02)
    np.testing.assert_allclose(np.degrees(chain.gyro_bias_radps), np.degrees(np.tile(BIAS, (110, 1))), atol=0.1)
    off_m, off_deg = errors(chain, truth)
    assert off_m.max() < 0.015 * chain.way_m[-1] and off_deg.max() < 1.0
    assert abs(chain.way_m[-1] / np.sum(np.linalg.norm(np.diff(truth.T_map_base[:, :3, 3], axis=0), axis=1)) - 1) < 0.1
    up = chain.Ts_odom_base[:, 2, :3]
    assert np.degrees(np.abs(up[:, :2])).max() < 0.3


def test_a_pothole_and_a_corner_leave_the_scale():
    """A second of 6 m/s^2 aside that the gyroscope does not show moves the scale by 1.3 % where it counts in full."""
    wheels, imu, _ = sensors()
    accel = imu.accel_mps2.copy()
    turning = np.abs(imu.time_s - 10.0) < 0.5
    accel[turning, 1] -= 6.0 * np.sign(accel[turning, 1])
    plain, chain = drive_chain(drive(wheels, imu)), drive_chain(drive(wheels, replace(imu, accel_mps2=accel)))
    assert abs(chain.calibration[0] - SCALE) < 3.0 * chain.calibration_sigma[0] < 0.03
    assert abs(chain.calibration[0] - plain.calibration[0]) < chain.calibration_sigma[0]


def test_covariances_hold_what_the_steps_are_off_by():
    """In the mean no coordinate of a step is off by more than it is said to be; the derivative by scale is the way."""
    wheels, imu, truth = sensors(1)
    chain = drive_chain(drive(wheels, imu))
    true = truth.interpolate(chain.times_s)
    step = rigid.log(rigid.inverse(rigid.inverse(true[:-1]) @ true[1:]) @ chain.steps)
    by_scale = chain.steps_jacobian[:, :, 0] * (chain.calibration[0] - SCALE)
    square = (step - by_scale) ** 2 / np.diagonal(chain.steps_covariance, axis1=1, axis2=2)
    assert np.all(square.mean(axis=0) < 1.5)
    forward_m = rigid.log(chain.steps)[:, 0]
    np.testing.assert_allclose(chain.steps_jacobian[:, 0, 0] * chain.calibration[0], forward_m, rtol=0.015, atol=1e-3)


def test_without_gyroscope_the_wheels_turn_the_vehicle():
    wheels, _, truth = sensors()
    chain = drive_chain(drive(wheels, None))
    assert chain.calibration[0] == 1.0 and not chain.gyro_bias_radps.any()
    off_m, _ = errors(chain, truth)
    assert off_m.max() < 0.08 * chain.way_m[-1]
    np.testing.assert_array_equal(chain.Ts_odom_base[:, 2, 3], 0.0)


def test_without_accelerometer_the_road_counts_as_level():
    wheels, imu, truth = sensors()
    chain = drive_chain(drive(wheels, Imu(imu.time_s, imu.gyro_radps, np.zeros_like(imu.accel_mps2))))
    assert chain.calibration[0] == pytest.approx(1.0, abs=1e-6)
    up = chain.Ts_odom_base[:, 2, :3]
    assert np.degrees(np.abs(up[:, :2])).max() < 2.0
    assert errors(chain, truth)[1].max() < 1.0


def test_a_drive_without_wheels_is_refused_with_what_is_missing():
    wheels, imu, _ = sensors()
    with pytest.raises(SemlocError, match="inertial data but no wheel odometry; expected the speed"):
        drive_chain(drive(None, imu))
    with pytest.raises(SemlocError, match="1 frames"):
        drive_chain(drive(wheels, imu, 1))
    late = WheelOdometry(wheels.time_s + 1e6, wheels.speed_mps, wheels.yaw_rate_radps)
    with pytest.raises(SemlocError, match="leaves 110 of 110 frames"):
        drive_chain(drive(late, imu))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "mean_m", "heading_deg"), [("loop_seed2", 2.0, 1.0), ("garage2_seed2", 0.8, 1.5)])
def test_drift_of_rendered_drives(data_dir, name, mean_m, heading_deg):
    """Two laps of 1.1 km of road and 0.6 km of a garage, by sensors with stated errors."""
    if not (data_dir / name).is_dir():
        pytest.skip(f"no drive {name} in {data_dir}")
    recorded = read_drive(data_dir / name)
    off_m, off_deg = errors(drive_chain(recorded), recorded.truth)
    assert off_m.mean() < mean_m and off_deg.max() < heading_deg
