"""`semloc odometry`: the way of a drive without any map (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from semloc_jax.cli.main import OK, log_to_console

if TYPE_CHECKING:
    from semloc_jax.localization.odometry import OdometryConfig


@dataclass(frozen=True)
class Options:
    """Follow a drive by cameras and inertial sensor, or by wheels, without any map.

    Writes trajectory.tum (T_odom_base of every frame: origin at the first pose, z up, x ahead), frames.csv (speed,
    biases, standard deviations), config.yaml, odometry.png, and metrics.json: drift as KITTI measures it where the
    drive has true poses. The first seconds give gravity, speed and scale; where they cannot, it says why.

    Clock and mount of the inertial sensor are taken as calibrated; --window.delay-sigma-s 0.02 and
    --window.mount-sigma-deg 1 let them be found (metrics.json: clock.offset, mount.turn).

    Every value of the configuration is an option too, e.g. --tracks.num-tracks 300:
    'semloc config odometry' prints them all.
    """

    drive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE")]
    """The drive: a folder or a bag (.bag, .db3, .mcap), its type is guessed."""
    calib: Path | None = None
    """Calibration file, where the drive has none of its own or another one is to be used; of Kalibr's camchain-imucam
    the shift of the clocks is used too."""
    imu: Path | None = None
    """imu.yaml of Kalibr: noise of the inertial sensor; default: imu.yaml beside the calibration or in the drive, else
    that of a production car."""
    motion: Literal["auto", "vio", "wheels", "both"] = "auto"
    """vio: cameras and inertial sensor; both: wheel speeds as well; wheels: wheels and gyroscope, no images; auto: what
    the drive has of these."""
    masks: str | None = None
    """Masks that show traffic, sky and the vehicle, where no corner is taken: a mask folder of the drive, any folder
    CAMERA/FRAME.png, or FILE.onnx; none: no masks; default: the drive's own masks where every camera has them."""
    class_table: str | None = None
    """What the ids in the masks mean: a preset or a YAML file; default: the drive's own."""
    cameras: str | None = None
    """Names of cameras, separated by commas: front,left; default: all that have images."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


NOT_KEPT = ("drive", "config", "out", "settings")
NO_MASKS = "none"


def default_settings() -> "OdometryConfig":
    """The default configuration of visual-inertial odometry."""
    from semloc_jax.localization.odometry import OdometryConfig

    return OdometryConfig()


def run(options: Options) -> int:
    """Follow the drive, print how far it drifted."""
    import dataclasses

    from semloc_jax.datasets import open_drive
    from semloc_jax.datasets.inertial import read_imu_noise
    from semloc_jax.inputs.choices import parse_names
    from semloc_jax.inputs.mask_source import mask_source
    from semloc_jax.localization.motion_source import resolved_without_map
    from semloc_jax.reports.odometry import report_odometry

    log_to_console()
    drive = open_drive(options.drive, options.calib)
    if options.imu is not None and drive.imu is not None:
        drive = dataclasses.replace(drive, imu=dataclasses.replace(drive.imu, noise=read_imu_noise(options.imu)))
    with_images = [name for name in drive.rig.names if drive.frames and drive.frames[0].has("rgb", name)]
    cameras = parse_names(options.cameras) or with_images or list(drive.rig.names)
    whole = [source for source in drive.mask_sources if all(drive.frames[0].has(source, camera) for camera in cameras)]
    motion = resolved_without_map(drive, options.motion, cameras)
    name = options.masks or (whole[0] if whole else NO_MASKS)
    is_masked = name != NO_MASKS and motion != "wheels" and bool(with_images)
    masks = mask_source(name, drive, cameras, options.class_table) if is_masked else None
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(Options)}
    kept = {key: value for key, value in given.items() if key not in NOT_KEPT and value is not None}
    kept |= {"masks": name, "cameras": ",".join(cameras), "motion": motion}
    report = report_odometry(drive, motion, cameras, masks, options.settings, options.out, kept)
    print(report.text)
    print(f"results: {report.folder}")
    return OK
