"""`semloc calibrate`: cameras, odometer and satellite offset from a drive, and what it cannot tell (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

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
    cameras are calibrated against each other, without drive and map.

    Every value of the configuration is an option too, e.g. --priors.mount-deg 1 or --intrinsics focal.
    """

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
    source = options.calib if options.calib is not None else options.drive
    if options.ground_points is not None:
        intrinsics = options.settings.intrinsics
        print(report_ground_calibration(source, options.ground_points, intrinsics, options.out))
        return OK
    inputs = open_inputs(options)
    how = (options.settings, options.reference, options.overlays)
    print(report_calibration(inputs, source, *how, options.out, options.kept(inputs)))
    return OK
