"""`semloc track`: follow the vehicle through a whole drive (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from semloc_jax.cli.drive_options import FleetOptions, run_each
from semloc_jax.cli.main import LOST, OK, log_to_console
from semloc_jax.inputs.choices import parse_slice

if TYPE_CHECKING:
    from semloc_jax.inputs.drive_inputs import Inputs
    from semloc_jax.localization.acquisition import Area
    from semloc_jax.localization.track_config import TrackConfig
    from semloc_jax.reports.track import TrackPlan

ALL, INERTIAL = "all", "inertial"


@dataclass(frozen=True)
class Options(FleetOptions):
    """Follow the vehicle through a drive: initialise, track, know when lost, recover.

    Writes frames.csv (line by line while driving), trajectory.tum, metrics.json, tracking.png, stanford.png,
    map_changes.csv, config.yaml, overlays/*.png and state.npz, from which --resume goes on after a kill.

    --prior gnss starts from the first satellite fixes; truth or a trajectory file give a first guess where there are
    none. The exit code is 3 when the vehicle is lost at the end, or tracked for less than --min-tracking-share.
    """

    frames: str = ":"
    """Which frames, as a Python slice: ::2, 10:60."""
    motion: Literal["auto", "wheels", "vio", "both"] = "auto"
    """What says how the vehicle moved between frames. vio: the inertial sensor, with cameras where the drive has
    images; both: wheels as well; auto: wheels where they are, else vio. The console says which."""
    fusion: Literal["window", "dropping", "kalman", "inertial", "single", "all"] | None = None
    """How poses are fused over time: sliding-window graph, one that drops its oldest state, Kalman filter, Kalman
    filter with velocity and biases of the inertial sensor, none (each frame alone); or all of them on the same
    features, for fusions.csv and fusions.md. Default: inertial with --motion vio and both, else window."""
    area: str | None = None
    """X,Y,RADIUS in the map: where to search when neither fixes nor a prior are given."""
    no_gnss_after_init: bool = False
    """Use satellite fixes to initialise only."""
    fault: str | None = None
    """Inject a fault: black_images, focal:3, kidnapped ...; or run the hostile suite: all, a family (map, calibration,
    time, odometry, gnss, masks) or a list with commas, for faults.csv, faults.md and stanford.png, worst first. With
    --frames :40 it takes a short drive, and --resume DIR goes on with a suite that was killed."""
    realtime: bool = False
    """Play the drive at its own pace; frames that come too fast are dropped."""
    resume: Path | None = None
    """Folder of a run that was killed: go on where it stopped."""
    min_tracking_share: float = 0.5
    """Exit code 3 below this share of frames called TRACKING."""
    overlays: int = 6
    """Number of pictures, spread over the drive; 0 for none."""
    video: bool = False
    """Write track.mp4."""
    rrd: Path | None = None
    """Write a recording for Rerun."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "TrackConfig":
    """The default configuration of the tracker."""
    from semloc_jax.localization.track_config import TrackConfig

    return TrackConfig()


def run(options: Options) -> int:
    """Track, print how good it is; returns the exit code."""
    from semloc_jax.reports import track, track_faults

    log_to_console()
    if options.others:
        return run_each("track", options)
    chosen, area = parse_slice(options.frames), _area(options.area)
    inputs = track.open_tracked(options, area is not None)
    plan, kept = _plan(options, area, inputs), options.kept(inputs)
    if options.fault is not None and _is_suite(options.fault):
        found = track.report_faults(inputs, plan, options.fault, chosen, options.out, options.resume, kept)
        return _print_table(found)
    if options.fault is not None:
        inputs = track_faults.disturbed(inputs, options.fault, options.seed)
    frames = list(inputs.drive.frames[chosen])
    if options.fusion == ALL:
        return _print_table(track.report_fusions(inputs, plan, frames, options.resume or options.out, kept))
    pictures = track.TrackPictures(options.overlays, options.video, options.rrd)
    report = track.report_track(inputs, plan, frames, options.out, pictures, options.resume, kept)
    print(report.text)
    print(f"results: {report.folder}")
    return LOST if report.is_lost or report.tracking_share < options.min_tracking_share else OK


def _is_suite(fault: str) -> bool:
    from semloc_jax.simulation.hostile import is_suite  # not for a run without faults: it brings a whole simulation

    return is_suite(fault)


def _plan(options: Options, area: "Area | None", inputs: "Inputs") -> "TrackPlan":
    from semloc_jax.errors import UsageError
    from semloc_jax.localization.motion_source import resolved
    from semloc_jax.reports.track import TrackPlan

    motion = resolved(inputs.drive, options.motion)
    by_speed = motion == "wheels"
    if not by_speed and options.fusion not in (None, INERTIAL):
        raise UsageError(
            f"--fusion {options.fusion} with --motion {motion}: it knows no velocity; use --fusion {INERTIAL}"
        )
    # A table of faults is made with one fusion.
    chosen = None if options.fusion == ALL else options.fusion
    return TrackPlan(
        options.settings,
        chosen or ("window" if by_speed else INERTIAL),
        motion,
        area,
        has_guess=options.prior not in (None, "gnss"),
        gnss_after_init=not options.no_gnss_after_init,
        realtime=options.realtime,
        seed=options.seed,
    )


def _print_table(report: tuple[Path, str, int]) -> int:
    """Print a table; the exit code is 3 where a frame was called tracked and was not."""
    folder, text, num_false = report
    print(text)
    print(f"results: {folder}")
    return LOST if num_false else OK


def _area(text: str | None) -> "Area | None":
    from semloc_jax.errors import UsageError
    from semloc_jax.localization.acquisition import Area

    if text is None:
        return None
    try:
        x, y, radius = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"--area '{text}': expected X,Y,RADIUS in metres, e.g. 12.5,-3,20") from error
    return Area(x, y, radius)
