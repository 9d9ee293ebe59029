"""What files and readings say of an inertial sensor: noise, clock, units and axes (room: datasets; host).

In: imu.yaml, camchain-imucam.yaml, a Drive. Out: InertialNoise, the shift between the clocks, the Drive with both, what
looks wrong in its readings.
"""

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from semloc_jax.cameras.io.fields import load_yaml, numbers, required
from semloc_jax.datasets.base import Drive
from semloc_jax.datasets.sensors import Imu
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


_GRAVITY_MPS2 = 9.81
_G_SHARE = 0.1
_UPRIGHT = 0.9
_TILT_S, _MOST_TILT_RAD = 1.0, 0.35
"""Pitch and roll of a road vehicle within a second (root mean square) are a tenth of this."""
_AXES = "xyz"


def wrong_forces(imu: Imu) -> str:
    """What the mean force says of units and axes: at rest and on average it is 9.81 m/s^2, upwards."""
    if not np.abs(imu.accel_mps2).any():
        return ""
    mean = np.mean(imu.accel_mps2, axis=0)
    size = float(np.linalg.norm(mean))
    if abs(size - 1.0) < _G_SHARE:
        return f"the mean force is {size:.2f}; expected 9.8 m/s^2: the unit is g; multiply by 9.81"
    if abs(size / _GRAVITY_MPS2 - 1.0) > _G_SHARE:
        return f"the mean force is {size:.2f}; expected 9.8 m/s^2 with gravity in it; check the unit"
    if mean[2] / size < -_UPRIGHT:
        return "the mean force points down (-z); expected up at rest (a specific force, z up): the sign is wrong"
    if mean[2] / size < _UPRIGHT:
        axis = int(np.argmax(np.abs(mean)))
        return (
            f"the mean force points along {'-' if mean[axis] < 0 else '+'}{_AXES[axis]}; expected +z (x ahead, y left, "
            "z up): the axes are not those of the vehicle; give T_body_imu or turn the columns"
        )
    return ""


def wrong_rates(imu: Imu) -> str:
    """What the rates say of their unit: about x and y they add up to how the vehicle tilts."""
    tilt_rad = _tilts(imu)
    size = float(np.sqrt(np.mean(tilt_rad**2))) if len(tilt_rad) else 0.0
    if size > _MOST_TILT_RAD:
        return (
            f"the rates about x and y tilt the vehicle by {np.rad2deg(size):.0f} deg within a second (root mean "
            "square); expected a degree or two: the unit is deg/s; divide by 57.3"
        )
    return ""


def require_usable(imu: Imu, what: str) -> None:
    """Refuse readings that cannot be those of a vehicle in rad/s and m/s^2.

    Raises:
        SemlocError: `what` and what is wrong.
    """
    wrong = wrong_forces(imu) or wrong_rates(imu)
    if wrong:
        raise SemlocError(f"{what}: imu: {wrong}; semloc check-calib looks at clock and mount, too")


def _tilts(imu: Imu) -> Float[np.ndarray, "n 2"]:
    """Angles about x and y over every second of the log."""
    step_s = np.minimum(np.diff(imu.time_s), _TILT_S)[:, None]
    rates = imu.gyro_radps[:, :2]
    angle = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * step_s * (rates[1:] + rates[:-1]), axis=0)])
    ends_s = np.arange(imu.time_s[0], imu.time_s[-1], _TILT_S)
    return np.diff(np.stack([np.interp(ends_s, imu.time_s, column) for column in angle.T], axis=1), axis=0)
