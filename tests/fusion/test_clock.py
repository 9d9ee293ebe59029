"""A clock that is late: what it does to the predicted motion, and how it is found."""

import numpy as np
import pytest

from semloc_jax.fusion.clock import CameraTimeLog, ClockConfig, ClockOffset, learned, unknown_offset
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.geometry import rigid

STEP_S = 0.1


def winding(late_s=0.0, seconds=14.0):
    """Samples of a drive that speeds up and winds, whose stamps are late."""
    log = MotionLog()
    for t in np.arange(-1.0, seconds + 1.0, 0.01):
        rate = 0.25 * np.sin(1.1 * t)
        log.add_imu(t + late_s, np.array([0.0, 0.0, rate]), np.zeros(3))
        log.add_wheels(t + late_s, 8.0 + 2.0 * np.sin(0.7 * t), rate)
    return log


def offset(offset_s, sigma_s=0.0):
    return ClockOffset(np.float64(offset_s), np.float64(sigma_s**2))


def test_a_late_log_in_the_time_of_the_cameras_is_the_log_in_time():
    right, late = winding(), CameraTimeLog(winding(0.05), offset(0.05))
    for t in (1.0, 2.3, 4.1):
        step = late.increment(t, t + STEP_S)
        assert (step.from_s, step.to_s) == (t, t + STEP_S)
        assert step.T_from_to == pytest.approx(right.increment(t, t + STEP_S).T_from_to, abs=1e-4)
    assert late.way_m(1.0, 2.0) == pytest.approx(right.way_m(1.0, 2.0), abs=1e-3)


@pytest.mark.parametrize("t", [0.4, 1.5, 3.0, 6.2])
def test_the_slope_is_the_difference_of_shifted_motions(t):
    log = winding()
    early, late = (log.increment(t + d, t + d + STEP_S).T_from_to for d in (-0.01, 0.01))
    expected = rigid.log(rigid.inverse(early) @ late) / 0.02
    found = CameraTimeLog(log, offset(0.0)).slope(t, t + STEP_S)
    assert found == pytest.approx(expected, abs=0.003)


def test_what_the_clock_may_be_off_by_is_in_the_covariance():
    log, t = winding(), 3.0
    plain, unsure = CameraTimeLog(log, offset(0.0)), CameraTimeLog(log, offset(0.0, 0.02))
    slope = plain.slope(t, t + STEP_S)
    grown = unsure.increment(t, t + STEP_S).covariance - plain.increment(t, t + STEP_S).covariance
    assert grown == pytest.approx(0.02**2 * np.outer(slope, slope), abs=1e-12)


@pytest.mark.parametrize("late_s", [-0.05, 0.0, 0.05])
def test_a_late_clock_is_found_within_milliseconds(late_s):
    rng, right, log, config = np.random.default_rng(3), winding(), winding(late_s), ClockConfig()
    clock, sigma = unknown_offset(config), np.array([0.01, 0.005, 0.005, 2e-4, 2e-4, 2e-4])
    for k in range(120):
        motion = CameraTimeLog(log, clock)
        step = motion.increment(k * STEP_S, (k + 1) * STEP_S)
        true = right.increment(k * STEP_S, (k + 1) * STEP_S).T_from_to
        difference = rigid.log(rigid.inverse(step.T_from_to) @ true) + sigma * rng.normal(size=6)
        slope = motion.slope(k * STEP_S, (k + 1) * STEP_S)
        covariance = step.covariance + np.diag(sigma**2)
        clock = learned(clock, slope, difference, covariance, STEP_S, config)
    assert float(clock.offset_s) == pytest.approx(late_s, abs=0.012)
    assert abs(float(clock.offset_s) - late_s) < 3.0 * np.sqrt(float(clock.variance_s2))
    assert np.sqrt(float(clock.variance_s2)) < 0.6 * config.sigma_s


def test_an_even_drive_and_an_outlier_say_nothing_of_the_clock():
    config = ClockConfig()
    before = unknown_offset(config)
    even = learned(before, np.zeros(6), np.full(6, 0.01), 1e-4 * np.eye(6), 0.1, config)
    wild = learned(before, np.full(6, 0.1), np.full(6, 1.0), 1e-4 * np.eye(6), 0.1, config)
    assert float(even.offset_s) == float(wild.offset_s) == 0.0
