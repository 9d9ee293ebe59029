"""What files say of the inertial sensor of a drive: the clock by a camchain, the noise by an imu.yaml (room: datasets).

In: a Drive, its calibration. Out: the Drive in the clock of its cameras, with the noise that is stated.
"""

import logging
from dataclasses import replace
from pathlib import Path

from semloc_jax.datasets.base import Drive
from semloc_jax.datasets.imu_noise import IMU_NOISE, clock_shift_s, read_imu_noise
from semloc_jax.errors import SemlocError

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
