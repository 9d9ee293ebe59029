"""`semloc check-calib`: is this calibration right? Numbers, warnings and pictures of it (room: cli)."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import LOST, OK
from semloc_jax.inputs.choices import parse_names


@dataclass(frozen=True)
class Options:
    """Check a calibration: what looks wrong in its numbers, and how it looks on a picture.

    For each camera the picture and the same without distortion are drawn with the horizon, a ground grid in the vehicle
    frame (blue lines run ahead every 2 m, amber ones across every 5 m) and, with a map and a pose, the map. All cameras
    together are drawn from above. The horizon must lie on the horizon, poles stand upright in the undistorted picture,
    and lines on the road run on from one camera to the next.

    Where the drive has inertial data, their units, axes, clock and mount are held against how the first camera with
    images turns.

    The exit code is 3 with --strict when something looks wrong.
    """

    path: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE|CALIBRATION")]
    """A drive of any kind, or a calibration file."""
    calib: Path | None = None
    """Calibration file to use for the drive."""
    image: Path | None = None
    """Picture of the (first chosen) camera, or a folder of pictures with the names of the cameras in theirs, where a
    calibration is given."""
    cameras: str | None = None
    """Names of cameras, separated by commas; default: all."""
    frame: int = 0
    """Index of the frame of the drive."""
    map: Path | None = None
    """Map to draw; default: the drive's own."""
    poses: Path | None = None
    """Trajectory of the vehicle for the map; default: the drive's truth, else its fixes."""
    imu: Path | None = None
    """imu.yaml of Kalibr: is the stated noise of the inertial sensor that of its log?"""
    strict: bool = False
    """Exit code 3 when something looks wrong."""
    out: Path | None = None
    """Folder for the pictures; default: results/TIME, to which results/latest points."""


def run(options: Options) -> int:
    """Print the calibration and what looks wrong in it, draw it."""
    from semloc_jax.reports.calibration_check import CalibrationCheck, report_calibration_check

    logging.basicConfig(format="%(message)s")
    given = (options.path, options.calib, options.image, parse_names(options.cameras), options.frame)
    report = report_calibration_check(CalibrationCheck(*given, options.map, options.poses, options.imu), options.out)
    print(report.text)
    return LOST if options.strict and report.findings else OK
