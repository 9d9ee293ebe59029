"""Motion of the vehicle from wheels and inertial sensor: arcs, gaps, order of arrival, derivatives and covariance."""

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.fusion.motion_noise import MotionNoise
from semloc_jax.fusion.prediction import Calibration, MotionLog, MotionQuality
from semloc_jax.geometry import rigid
from semloc_jax.structs import InertialNoise

STILL = np.array([0.0, 0.0, 9.81])


def speed(t):
    return 10.0 + 2.0 * np.sin(0.7 * t)


def yaw_rate(t):
    return 0.2 * np.cos(0.5 * t)


def true_motion(from_s, to_s, num=20000):
    """Planar motion by fine midpoint integration."""
    t = np.linspace(from_s, to_s, num + 1)
    middle, dt = 0.5 * (t[1:] + t[:-1]), (to_s - from_s) / num
    yaw = np.concatenate([[0.0], np.cumsum(yaw_rate(middle) * dt)])
    heading = 0.5 * (yaw[1:] + yaw[:-1])
    x, y = np.sum(speed(middle) * np.cos(heading)) * dt, np.sum(speed(middle) * np.sin(heading)) * dt
    return x, y, yaw[-1]


def filled(to_s=6.0, wheels=True, imu=True, scale=1.0, bias=0.0, gap=(np.inf, np.inf), order=None):
    """A log of the drive above with sensors that are off by scale and bias; nothing arrives inside the gap."""
    samples = []
    if wheels:
        samples += [("wheels", t) for t in np.arange(0.0, to_s, 0.02)]
    if imu:
        samples += [("imu", t) for t in np.arange(0.003, to_s, 0.01)]
    log = MotionLog()
    for kind, t in np.array(samples, dtype=object)[order if order is not None else slice(None)]:
        if gap[0] < t < gap[1]:
            continue
        if kind == "wheels":
            log.add_wheels(t, speed(t) / scale, yaw_rate(t))
        else:
            log.add_imu(t, np.array([0.0, 0.0, yaw_rate(t) + bias]), STILL)
    return log


def difference(T, x, y, yaw):
    """Distance [m] and turn [rad] between a motion and a planar one."""
    found_yaw = np.arctan2(T[1, 0], T[0, 0])
    return np.hypot(T[0, 3] - x, T[1, 3] - y), abs(found_yaw - yaw)


@pytest.mark.parametrize("imu", [True, False])
def test_a_winding_drive_within_a_millimetre(imu):
    increment = filled(imu=imu).increment(0.513, 5.207)
    off_m, off_rad = difference(increment.T_from_to, *true_motion(0.513, 5.207))
    assert off_m < 1e-3 and off_rad < 2e-5
    assert increment.quality is MotionQuality.OK


def test_increments_compose_forth_and_back():
    log = filled()
    whole, first, second = log.increment(1.0, 2.0), log.increment(1.0, 1.437), log.increment(1.437, 2.0)
    assert np.allclose(first.T_from_to @ second.T_from_to, whole.T_from_to, atol=1e-5)
    Ad = rigid.adjoint(rigid.inverse(second.T_from_to))
    chained = Ad @ first.covariance @ Ad.T + second.covariance
    assert np.allclose(np.diag(chained), np.diag(whole.covariance), rtol=0.02)
    assert np.allclose(Ad @ first.jacobian + second.jacobian, whole.jacobian, atol=2e-3)
    back = log.increment(2.0, 1.0)
    assert np.allclose(back.T_from_to @ whole.T_from_to, np.eye(4), atol=1e-12)
    nothing = log.increment(2.0, 2.0)
    assert np.array_equal(nothing.T_from_to, np.eye(4)) and not nothing.covariance.any()


def test_way_is_the_integral_of_the_speed():
    log, (x, y, _) = filled(), true_motion(1.0, 1.1)
    assert log.way_m(1.0, 1.1) == pytest.approx(np.hypot(x, y), rel=1e-4)
    whole = sum(speed(t) * 0.001 for t in np.arange(0.5, 4.5, 0.001))
    assert log.way_m(0.5, 4.5) == pytest.approx(whole, rel=1e-3)
    assert log.way_m(2.0, 2.0) == 0.0 and MotionLog().way_m(0.0, 1.0) == 0.0


def test_order_of_arrival_does_not_matter():
    shuffled = np.random.default_rng(1).permutation(len(np.arange(0.0, 2.0, 0.02)) + len(np.arange(0.003, 2.0, 0.01)))
    one, other = filled(2.0).increment(0.2, 1.8), filled(2.0, order=shuffled).increment(0.2, 1.8)
    assert np.array_equal(one.T_from_to, other.T_from_to) and np.array_equal(one.covariance, other.covariance)


def test_left_and_right_wheels_are_speed_and_yaw_rate():
    log = MotionLog()
    for t in np.arange(0.0, 3.0, 0.02):
        log.add_wheel_pair(t, speed(t) - 0.8 * yaw_rate(t), speed(t) + 0.8 * yaw_rate(t), track_m=1.6)
    off_m, off_rad = difference(log.increment(0.5, 2.5).T_from_to, *true_motion(0.5, 2.5))
    assert off_m < 1e-3 and off_rad < 2e-5


@pytest.mark.parametrize("backwards", [False, True])
def test_derivative_by_the_calibration_is_that_of_finite_differences(backwards):
    log, at, step = filled(scale=1.02, bias=0.004), Calibration(1.01, 0.002, 0.03), 1e-5
    from_s, to_s = (3.0, 1.0) if backwards else (1.0, 3.0)
    increment = log.increment(from_s, to_s, at)
    for k in range(3):
        d = step * np.eye(3)[k]
        plus, minus = (log.increment(from_s, to_s, Calibration(*(at + sign * d))).T_from_to for sign in (1.0, -1.0))
        assert np.allclose(rigid.log(rigid.inverse(minus) @ plus) / (2 * step), increment.jacobian[:, k], atol=1e-5)
    true = Calibration(1.02, 0.004, 0.032)
    assert np.allclose(increment.corrected(true), log.increment(from_s, to_s, true).T_from_to, atol=2e-3)


def test_right_calibration_removes_the_errors_of_the_sensors():
    log = filled(scale=1.03, bias=0.01)
    assert difference(log.increment(1.0, 5.0).T_from_to, *true_motion(1.0, 5.0))[0] > 1.0
    off_m, _ = difference(log.increment(1.0, 5.0, Calibration(1.03, 0.01)).T_from_to, *true_motion(1.0, 5.0))
    assert off_m < 1e-3


def test_covariance_is_the_scatter_of_noisy_logs():
    """250 logs whose samples carry the white noise that the model states, no slip: the spread is the stated one."""
    noise, sensor = MotionNoise(slip_share=0.0, gyro_turn_share=0.0), InertialNoise(gyro_density=1e-3)
    rng = np.random.default_rng(2)
    ends = []
    for _ in range(250):
        log = MotionLog(noise)
        log.inertial_noise = sensor
        for t in np.arange(0.0, 1.001, 0.1):
            log.add_wheels(t, 10.0 + noise.speed_density_mps / np.sqrt(0.1) * rng.normal(), 0.0)
            gyro = np.array([0.0, 0.0, sensor.gyro_density / np.sqrt(0.1) * rng.normal()])
            log.add_imu(t, gyro, STILL)
        increment = log.increment(0.0, 1.0)
        ends.append(rigid.log(increment.T_from_to)[[0, 5]])
    spread = np.std(ends, axis=0)
    stated = np.sqrt(np.diag(increment.covariance))[[0, 5]]
    # Trapezoids weigh the two end samples by one half: 9.5 samples of 10 squared.
    assert np.allclose(spread / stated, np.sqrt(0.95), atol=0.1)


@pytest.mark.parametrize("gyro_only", [False, True])
def test_a_silent_wheel_is_replaced_by_its_last_speed_with_growing_covariance(gyro_only):
    """Two seconds without wheels: the speed of before goes on, the gyroscope turns on; 3 sigma hold the truth."""
    log, full = filled(imu=False, gap=(2.0, 4.0)), filled()
    for t in np.arange(0.003, 6.0, 0.01) if gyro_only else ():
        log.add_imu(t, np.array([0.0, 0.0, yaw_rate(t)]), np.zeros(3))
    x, y, yaw = true_motion(2.0, 4.0)
    increment = log.increment(2.0, 4.0)
    off_m, off_rad = difference(increment.T_from_to, x, y, yaw)
    assert increment.quality is MotionQuality.EXTRAPOLATED and full.increment(2.0, 4.0).quality is MotionQuality.OK
    assert 0.5 < off_m < 3.0 * np.sqrt(increment.covariance[0, 0])
    assert off_rad < (1e-4 if gyro_only else 3.0 * np.sqrt(increment.covariance[5, 5]))
    # (2 m/s^2) (2 s)^2 / 2 = 4 m in one piece; 2 m/s^2 (2 s)^1.5 (0.1 s / 3)^0.5 = 1.03 m in twenty.
    assert np.sqrt(increment.covariance[0, 0]) == pytest.approx(4.0, rel=0.05)
    variance = sum(log.increment(t, t + 0.1).covariance[0, 0] for t in np.arange(2.0, 3.95, 0.1))
    assert off_m < 3.0 * np.sqrt(variance) and np.sqrt(variance) == pytest.approx(1.03, rel=0.05)


@pytest.mark.parametrize("tilt_mps2", [0.0, 0.6])
def test_the_accelerometer_carries_the_speed_over_a_gap_of_the_wheels(tilt_mps2):
    """A slope or bias of 0.6 m/s^2 is known from before: 2 s without wheels cost centimetres, not 0.7 m."""
    log = filled(imu=False, gap=(2.0, 4.0))
    for t in np.arange(0.003, 6.0, 0.01):
        forward = 1.4 * np.cos(0.7 * t) + tilt_mps2
        log.add_imu(t, np.array([0.0, 0.0, yaw_rate(t)]), np.array([forward, 0.0, 9.8]))
    increment = log.increment(2.0, 4.0)
    off_m, off_rad = difference(increment.T_from_to, *true_motion(2.0, 4.0))
    assert increment.quality is MotionQuality.EXTRAPOLATED and off_m < 0.06 and off_rad < 1e-4
    # (0.3 m/s^2) (2 s)^2 / 2 = 0.6 m
    assert np.sqrt(increment.covariance[0, 0]) == pytest.approx(0.6, rel=0.1)
    parts = np.eye(4)
    for t in np.arange(2.0, 3.95, 0.1):
        parts = parts @ log.increment(t, t + 0.1).T_from_to
    assert np.allclose(parts, increment.T_from_to, atol=2e-3)


def test_all_sensors_silent_is_constant_velocity_then_unknown():
    log = filled(gap=(2.0, np.inf))
    held = log.increment(2.0, 3.0)
    assert held.quality is MotionQuality.EXTRAPOLATED
    assert rigid.log(held.T_from_to)[[0, 5]] == pytest.approx([speed(2.0), yaw_rate(2.0)], rel=0.02)
    late = log.increment(8.0, 8.5)
    assert late.quality is MotionQuality.MISSING and np.array_equal(late.T_from_to, np.eye(4))
    assert np.sqrt(late.covariance[0, 0]) == pytest.approx(7.5)
    assert MotionLog().increment(0.0, 0.1).quality is MotionQuality.MISSING


def test_the_sample_after_a_gap_is_not_known_inside_it():
    log = filled(gap=(2.0, 4.0), imu=False)
    before = log.increment(2.5, 2.6).T_from_to
    log.add_wheels(4.0, 99.0, 3.0)
    assert np.array_equal(log.increment(2.5, 2.6).T_from_to, before)


def test_forgetting_keeps_what_is_needed():
    log = filled()
    before = log.increment(4.0, 5.0)
    log.forget(4.0)
    assert np.array_equal(log.increment(4.0, 5.0).T_from_to, before.T_from_to)
    assert log.increment(1.0, 1.1).quality is MotionQuality.MISSING


def test_samples_that_are_no_numbers_are_refused():
    with pytest.raises(SemlocError, match="not finite"):
        MotionLog().add_wheels(0.0, np.nan, 0.0)
    with pytest.raises(SemlocError, match="track"):
        MotionLog().add_wheel_pair(0.0, 1.0, 1.0, track_m=0.0)
