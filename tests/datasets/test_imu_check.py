"""Units and axes of an inertial sensor by its readings alone; what can be right is let through."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.datasets import Imu
from semloc_jax.datasets.inertial import require_usable, wrong_forces, wrong_rates
from semloc_jax.errors import SemlocError


def log_of(seconds=20.0, slope_deg=5.0):
    """A vehicle that brakes, turns and rocks on its springs, uphill, with biases."""
    t = np.arange(0.0, seconds, 0.01)
    rocking = np.deg2rad(3.0) * np.cos(2.0 * np.pi * 1.3 * t)
    gyro = np.column_stack([0.5 * rocking, rocking, 0.4 * np.sin(0.5 * t)]) + [0.01, -0.01, 0.005]
    slope = np.deg2rad(slope_deg)
    ahead = 9.81 * np.sin(slope) + 2.0 * np.sin(0.7 * t)
    up = 9.81 * np.cos(slope) + 0.3 * np.cos(8.0 * t)
    return Imu(t, gyro, np.column_stack([ahead, 3.0 * np.sin(0.5 * t), up]))


@pytest.mark.parametrize("seconds", [0.5, 3.0, 20.0])
def test_a_rough_drive_uphill_is_let_through(seconds):
    imu = log_of(seconds)
    assert wrong_forces(imu) == "" and wrong_rates(imu) == ""
    require_usable(imu, "drive x")


def turned(imu, R):
    return replace(imu, gyro_radps=imu.gyro_radps @ R.T, accel_mps2=imu.accel_mps2 @ R.T)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda imu: replace(imu, accel_mps2=imu.accel_mps2 / 9.81), "the unit is g; multiply by 9.81"),
        (lambda imu: replace(imu, accel_mps2=imu.accel_mps2 - [0.0, 0.0, 9.81]), "with gravity in it"),
        (lambda imu: replace(imu, gyro_radps=np.rad2deg(imu.gyro_radps)), "the unit is deg/s; divide by 57.3"),
        (lambda imu: replace(imu, accel_mps2=-imu.accel_mps2), "the sign is wrong"),
        # A phone that stands in its holder: y up, z to the driver.
        (lambda imu: turned(imu, np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])), "points along \\+y; expected \\+z"),
    ],
)
def test_wrong_units_and_axes_are_refused_in_one_line(change, said):
    with pytest.raises(SemlocError, match=said) as error:
        require_usable(change(log_of()), "drive x")
    assert str(error.value).startswith("drive x: imu: ") and "\n" not in str(error.value)
