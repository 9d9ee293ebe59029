"""`semloc calibrate`: cameras, odometer and satellite offset from a drive, and what it cannot tell (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from semloc_jax.cli.drive_options import DriveOptions
from semloc_jax.cli.main import OK, log_to_console
from semloc_jax.inputs.drive_inputs import open_inputs

if TYPE_CHECKING:
    from semloc_jax.calibration import SelfCalibrationConfig


@dataclass(frozen=True)
class Options(DriveOptions):
    """Calibrate the cameras of a vehicle from a drive through a map.

    Writes the corrected calibration (calib.yaml with the keys that it had), report.txt, observability.csv,
    calibration.json (odometer scale, gyroscope bias, GNSS offset, directions that are not observable), trajectory.tum,
    observability.png, overlays/*.png and config.yaml.

    What the drive does not constrain stays at its prior and is listed. With --ground-points DRIVE is a calibration: its
    cameras are calibrated against each other, without drive and map. With --targets there is no drive: lenses come from
    views of a chessboard or ChArUco board, mounts from surveyed mats on the ground (calib.yaml, corners.csv,
    metrics.json, targets.png with the residuals and what the views do not cover).

    Every value of the configuration is an option too, e.g. --priors.mount-deg 1 or --intrinsics focal.
    """

    drive: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="DRIVE")] = None
    """The drive: a folder or a bag (.bag, .db3, .mcap), its type is guessed; none with --targets."""
    targets: Path | None = None
    """Folder with targets.yaml (board and mat: inner corners, side of the squares), boards/CAMERA/*.png,
    mats/CAMERA.png, mats.csv (mat, column, row, x_m, y_m), and calib.yaml or --calib: lenses by data sheet, mounts by
    drawing. `semloc simulate OUT --kind targets` makes one."""
    reference: str | None = None
    """Poses of the vehicle from elsewhere: truth, or a trajectory file in the frame of the map. They give the position
    of the cameras on the vehicle, which a drive alone hardly constrains."""
    ground_points: Path | None = None
    """Table camera_a,u_a,v_a,camera_b,u_b,v_b: pixels of the same ground point in two cameras."""
    overlays: int = 4
    """Number of before/after pictures, spread over the frames; 0 for none."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "SelfCalibrationConfig":
    """The default configuration of a calibration."""
    from semloc_jax.calibration import SelfCalibrationConfig

    return SelfCalibrationConfig()


def run(options: Options) -> int:
    """Calibrate, print what is known."""
    from semloc_jax.reports.calibration import report_calibration, report_ground_calibration

    log_to_console()
    if options.targets is not None:
        from semloc_jax.reports.target_calibration import report_target_calibration

        print(report_target_calibration(options.targets, options.calib, options.out))
        return OK
    if options.drive is None:
        from semloc_jax.errors import UsageError

        raise UsageError("no drive; give DRIVE, or --targets FOLDER with pictures of calibration targets")
    source = options.calib if options.calib is not None else options.drive
    if options.ground_points is not None:
        intrinsics = options.settings.intrinsics
        print(report_ground_calibration(source, options.ground_points, intrinsics, options.out))
        return OK
    inputs = open_inputs(options)
    how = (options.settings, options.reference, options.overlays)
    print(report_calibration(inputs, source, *how, options.out, options.kept(inputs)))
    return OK
