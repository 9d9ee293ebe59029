"""What files say of an inertial sensor: noise by imu.yaml, the clock by camchain-imucam.yaml (room: datasets; host).

In: the files, a Drive. Out: InertialNoise, the shift between the clocks, the Drive with both.
"""

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from semloc_jax.cameras.io.fields import load_yaml, numbers, required
from semloc_jax.datasets.base import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.structs import InertialNoise

IMU_NOISE = "imu.yaml"
"""Kalibr's name for the noise of an inertial sensor."""
_LARGEST_SHIFT_S = 1.0
_KEYS = (
    "gyroscope_noise_density", "accelerometer_noise_density", "gyroscope_random_walk", "accelerometer_random_walk"
)  # fmt: skip
"""In the order of `InertialNoise`."""


def read_imu_noise(path: str | Path) -> InertialNoise:
    """The noise that an imu.yaml or the sensor.yaml of EuRoC states, its keys at the top or under imu0.

    Raises:
        SemlocError: a value is missing or is not positive.
    """
    return imu_noise_in(load_yaml(Path(path)), f"imu noise {path}")


def imu_noise_in(content: Mapping[str, Any], where: str) -> InertialNoise:
    """The same of what the file holds; `where` names it in errors.

    Raises:
        SemlocError: a value is missing or is not positive.
    """
    inner = content.get("imu0", content)
    if not isinstance(inner, Mapping):
        raise SemlocError(f"{where}: given {repr(inner)[:80]}; expected gyroscope_noise_density and the like")
    values = []
    for key in _KEYS:
        value = float(numbers(required(inner, key, where), (1,), f"{where} {key}")[0])
        if not value > 0.0:
            raise SemlocError(f"{where}: {key} = {value:g}; expected a positive density")
        values.append(value)
    return InertialNoise(*values)


def clock_shift_s(path: str | Path) -> float:
    """Clock of the inertial sensor less that of the cameras: timeshift_cam_imu of the first camera, 0 where none is.

    Raises:
        SemlocError: the shift is no number or is larger than 1 s.
    """
    content = load_yaml(Path(path))
    entry = content.get("cam0")
    if not isinstance(entry, Mapping) or "timeshift_cam_imu" not in entry:
        return 0.0
    where = f"calibration {path}: cam0 timeshift_cam_imu"
    shift = float(numbers(entry["timeshift_cam_imu"], (1,), where)[0])
    if not abs(shift) <= _LARGEST_SHIFT_S:
        raise SemlocError(f"{where} = {shift:g}; expected seconds, at most {_LARGEST_SHIFT_S:g}")
    return shift


def imu_yaml(noise: InertialNoise) -> str:
    """The text of an imu.yaml."""
    values = noise.gyro_density, noise.accel_density, noise.gyro_walk, noise.accel_walk
    return "".join(f"{key}: {value:g}\n" for key, value in zip(_KEYS, values, strict=True))


_LOG = logging.getLogger(__name__)


def with_inertial_calibration(drive: Drive, calibration: str | Path | None = None) -> Drive:
    """The drive with its inertial samples in the clock of the cameras and the noise of its sensor as stated.

    Args:
        drive: An `imu.yaml` in its folder, or beside its file, states the noise.
        calibration: A camchain states the clock (`timeshift_cam_imu`); an `imu.yaml` beside it goes before the drive's.

    Raises:
        SemlocError: the camchain states a shift that is none. An `imu.yaml` that nobody named costs itself only.
    """
    if drive.imu is None:
        return drive
    imu, given = drive.imu, None if calibration is None else Path(calibration)
    if given is not None and given.is_file() and given.suffix in (".yaml", ".yml"):
        imu = replace(imu, time_s=imu.time_s - clock_shift_s(given))
    own = drive.path if drive.path.is_dir() else drive.path.parent
    places = [own] if given is None else [given if given.is_dir() else given.parent, own]
    stated = next((place / IMU_NOISE for place in places if (place / IMU_NOISE).is_file()), None)
    if stated is not None:
        try:
            imu = replace(imu, noise=read_imu_noise(stated))
        except SemlocError as error:
            _LOG.warning("%s; that of a production car is taken", error)
    return replace(drive, imu=imu)
