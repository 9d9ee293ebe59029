"""The clock of an inertial sensor by a calibration file (room: inputs; host).

In: a Drive, a camchain with the shift of the clocks. Out: the Drive in the clock of its cameras.
"""

from dataclasses import replace
from pathlib import Path

from semloc_jax.datasets import Drive, Imu
from semloc_jax.datasets.imu_noise import clock_shift_s


def in_camera_time(drive: Drive, calibration: Path | None) -> Drive:
    """The drive with its inertial samples in the clock of the cameras, by `timeshift_cam_imu` of the calibration."""
    is_file = calibration is not None and calibration.is_file() and calibration.suffix in (".yaml", ".yml")
    if drive.imu is None or not is_file:
        return drive
    imu, shift_s = drive.imu, clock_shift_s(calibration)
    return replace(drive, imu=Imu(imu.time_s - shift_s, imu.gyro_radps, imu.accel_mps2)) if shift_s else drive
