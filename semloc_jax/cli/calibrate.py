"""`semloc calibrate`: cameras, odometer and satellite offset from a drive, and what it cannot tell (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from semloc_jax.cli.drive_options import DriveOptions
from semloc_jax.cli.main import OK, log_to_console
from semloc_jax.inputs.drive_inputs import open_inputs

if TYPE_CHECKING:
    from semloc_jax.calibration import SelfCalibrationConfig


@dataclass(frozen=True)
class Options(DriveOptions):
    """Calibrate the cameras of a vehicle from a drive, through a map or without one.

    Writes the corrected calibration (calib.yaml with the keys that it had), report.txt, observability.csv,
    calibration.json (odometer scale, gyroscope bias, GNSS offset, directions that are not observable), trajectory.tum,
    observability.png, overlays/*.png and config.yaml.

    With --against road there is no map: the paint of the road, seen by two cameras and at two times, has to lie at one
    place. That takes slow driving over a flat lot or garage, wheels, and mounts known to a degree and 10 cm; lines come
    first, then the pictures themselves where there are any. lines.png shows the lines before and after.

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
    against: Literal["map", "road"] | None = None
    """What the cameras are compared with: the map, or the road itself; default: the map where there is one."""
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
    if _is_by_road(options):
        return _by_road(options, source)
    inputs = open_inputs(options)
    how = (options.settings, options.reference, options.overlays)
    print(report_calibration(inputs, source, *how, options.out, options.kept(inputs)))
    return OK


def _is_by_road(options: Options) -> bool:
    """Whether the cameras are held against the road: asked for, or there is no map."""
    from semloc_jax.datasets import open_drive
    from semloc_jax.inputs.sweeps import has_sweeps

    if options.against is not None:
        return options.against == "road"
    drive = open_drive(options.drive, options.calib)
    return options.map is None and drive.map_path is None and not has_sweeps(drive)


def _by_road(options: Options, source: Path) -> int:
    from semloc_jax.datasets import open_drive
    from semloc_jax.errors import UsageError
    from semloc_jax.inputs.choices import parse_names
    from semloc_jax.inputs.mask_source import best_masks, mask_source
    from semloc_jax.reports.calibration import report_road_calibration

    if options.map is not None:
        raise UsageError("--against road takes no map; leave --map out, or use --against map")
    if options.reference is not None:
        raise UsageError("--reference gives poses in a map; --against road has none: leave it out")
    drive = open_drive(options.drive, options.calib)
    name = options.masks or best_masks(drive)
    masks = mask_source(name, drive, parse_names(options.cameras), options.class_table)
    kept = {"masks": masks.name, "cameras": ",".join(masks.cameras), "against": "road"}
    print(report_road_calibration(drive, masks, source, options.settings, options.out, kept))
    return OK
