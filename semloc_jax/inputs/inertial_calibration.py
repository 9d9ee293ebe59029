"""What calibration files say of an inertial sensor, put where it belongs (room: inputs; host).

In: a Drive, a camchain with the shift of the clocks, imu.yaml. Out: the Drive in the clock of its cameras, beliefs.
"""

from dataclasses import replace
from pathlib import Path

from semloc_jax.datasets import Drive, Imu
from semloc_jax.datasets.imu_noise import clock_shift_s, read_imu_noise
from semloc_jax.fusion.inertial_moment import InertialWindowConfig


def in_camera_time(drive: Drive, calibration: Path | None) -> Drive:
    """The drive with its inertial samples in the clock of the cameras, by `timeshift_cam_imu` of the calibration."""
    is_file = calibration is not None and calibration.is_file() and calibration.suffix in (".yaml", ".yml")
    if drive.imu is None or not is_file:
        return drive
    imu, shift_s = drive.imu, clock_shift_s(calibration)
    return replace(drive, imu=Imu(imu.time_s - shift_s, imu.gyro_radps, imu.accel_mps2)) if shift_s else drive


def with_stated_noise(config: InertialWindowConfig, path: Path | None) -> InertialWindowConfig:
    """The beliefs of a window with the noise that imu.yaml states."""
    if path is None:
        return config
    noise = read_imu_noise(path)
    return replace(
        config,
        gyro_density=noise.gyro_density,
        accel_density=noise.accel_density,
        gyro_walk=noise.gyro_walk,
        accel_walk=noise.accel_walk,
    )
