"""What Kalibr's files say of an inertial sensor: imu.yaml and the clock in camchain-imucam.yaml (room: datasets; host).

In: the files. Out: ImuNoise, the shift between the clocks.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from semloc_jax.cameras.io.fields import load_yaml, numbers, required
from semloc_jax.errors import SemlocError

_LARGEST_SHIFT_S = 1.0


@dataclass(frozen=True)
class ImuNoise:
    """Noise of an inertial sensor, as Kalibr and OpenVINS state it.

    Args:
        gyro_density: white noise [rad/s per root of Hz].
        accel_density: white noise [m/s^2 per root of Hz].
        gyro_walk: change of the bias [rad/s per root of s].
        accel_walk: change of the bias [m/s^2 per root of s].
    """

    gyro_density: float
    accel_density: float
    gyro_walk: float
    accel_walk: float


def read_imu_noise(path: str | Path) -> ImuNoise:
    """The noise that an imu.yaml states, its keys at the top or under imu0.

    Raises:
        SemlocError: a value is missing or is not positive.
    """
    content: Mapping[str, Any] = load_yaml(Path(path))
    where = f"imu noise {path}"
    inner = content.get("imu0", content)
    if not isinstance(inner, Mapping):
        raise SemlocError(f"{where}: given {repr(inner)[:80]}; expected gyroscope_noise_density and the like")
    keys = ("gyroscope_noise_density", "accelerometer_noise_density", "gyroscope_random_walk")
    values = []
    for key in (*keys, "accelerometer_random_walk"):
        value = float(numbers(required(inner, key, where), (1,), f"{where} {key}")[0])
        if not value > 0.0:
            raise SemlocError(f"{where}: {key} = {value:g}; expected a positive density")
        values.append(value)
    return ImuNoise(*values)


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
