"""`semloc map`: a map of a drive from its masks and odometry, without any other map (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from semloc_jax.cli.main import OK, log_to_console

if TYPE_CHECKING:
    from semloc_jax.datasets import Drive
    from semloc_jax.inputs.mask_view import MaskSource
    from semloc_jax.mapping.mapper import MapConfig
    from semloc_jax.reports.map_request import MapRequest


@dataclass(frozen=True)
class Options:
    """Make a map of a drive from its masks and its motion, with a sigma and an existence for every element.

    It holds paint, curbs, poles, pillars, signs and lights. Writes map.gpkg and map.geojson (open with every verb),
    trajectory.tum (T_map_base of every frame), loops.csv (places that the drive came to again), elements.csv,
    config.yaml (resolved; reads back with --config), map.png, overlays/*.png, and metrics.json: against the poses and
    the map of the drive, where it has them, after one motion in the plane. What is finished is kept in parts/ until
    the end, for --resume after a kill.

    Every value of the configuration is an option too, e.g. --min-seen 5: 'semloc config map' prints them all.
    """

    drive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE")]
    """The drive: a folder or a bag (.bag, .db3, .mcap), its type is guessed."""
    calib: Path | None = None
    """Calibration file; default: the drive's own."""
    masks: str | None = None
    """Mask folder of the drive (sem, sem_net ...), any folder CAMERA/FRAME.png, or a segmenter that runs on the images
    (classical, FILE.onnx); default: the drive's best masks."""
    front: Literal["masks", "classical"] = "masks"
    """What sees the road: masks, or the segmenter that works on the images without a network: --masks classical."""
    class_table: str | None = None
    """What the ids in the masks mean: a preset or a YAML file; default: the drive's own."""
    cameras: str | None = None
    """Names of cameras, separated by commas: front,left; default: all."""
    motion: Literal["auto", "wheels", "vio", "both"] = "auto"
    """What gives the way of the drive. vio: cameras and inertial sensor; both: wheels as well; auto: wheels where they
    are, else vio."""
    frames: str = ":"
    """Which frames look at the road, as a Python slice: ::2, 100:200; the way is that of the whole drive."""
    start: str | None = None
    """What fixes the frame of the map: gnss (their common offset stays in the map), truth or a trajectory file (pose of
    the first frame), identity (the first frame); default: gnss where the drive has fixes, else identity."""
    base: Path | None = None
    """A map that is there already: the drive is found in it from its fixes or --start (within some 5 m), its elements
    are seen or missed, what is new is added (map.gpkg), what is gone is left out (changes.csv, places.csv)."""
    no_loops: bool = False
    """Do not look for places that the drive comes to again: they tie its way down, and cost seconds each."""
    no_gnss: bool = False
    """Leave satellite fixes out: the default of --start then is identity."""
    baseline: Literal["avp", "road-slam"] | None = None
    """Also make the way and the map as the literature does, into baseline_NAME, and print both side by side: avp
    (class-wise ICP of local maps of points, AVP-SLAM) or road-slam (marks classified by a random forest, sub-maps met
    by two marks at a time; needs scikit-learn). A map of the same drive and options that is in --out is not made
    again."""
    overlays: int = 4
    """Number of frames with the map drawn into their images; 0 for none."""
    video: bool = False
    """Write map.mp4: the map as it grows, in the images of the first camera and from above."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""
    resume: Path | None = None
    """Folder of a run that was killed, to go on with: give the same drive and options as then."""


NOT_KEPT = ("drive", "front", "config", "out", "resume", "baseline", "settings")


def default_settings() -> "MapConfig":
    """The default configuration of a map."""
    from semloc_jax.mapping.mapper import MapConfig

    return MapConfig()


def run(options: Options) -> int:
    """Make the map, print how good it is."""
    from semloc_jax.reports.mapping import report_map

    log_to_console()
    request = _request(options)
    # Beside a baseline, a map that is there already is not made again.
    known = options.baseline is not None and options.out is not None and options.resume is None
    if known and request.is_made(options.out):
        return _beside(options, request, options.out)
    report = report_map(request, options.out, options.resume, options.overlays, options.video)
    print(report.text)
    if options.baseline is not None:
        return _beside(options, request, report.folder)
    print(f"results: {report.folder}")
    return OK


def _request(options: Options) -> "MapRequest":
    """What the words of the command line ask for."""
    import dataclasses

    from semloc_jax.datasets import open_drive
    from semloc_jax.errors import SemlocError, UsageError
    from semloc_jax.inputs.choices import parse_names, parse_slice
    from semloc_jax.inputs.mask_source import mask_source
    from semloc_jax.reports.map_request import MapRequest

    chosen = parse_slice(options.frames)
    if options.no_gnss and options.start == "gnss":
        raise UsageError("--start gnss with --no-gnss: choose one of them")
    drive = open_drive(options.drive, options.calib)
    if options.no_gnss:
        drive = dataclasses.replace(drive, gnss=None)
    masks = mask_source(_masks_of(options, drive), drive, parse_names(options.cameras), options.class_table)
    frames = drive.frames[chosen]
    if not frames:
        raise SemlocError(f"drive {drive.name}: no frames chosen of {len(drive)}; check --frames {options.frames}")
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(Options)}
    kept = {k: v for k, v in given.items() if k not in NOT_KEPT and v is not None and v is not False}
    kept |= {"masks": masks.name, "cameras": ",".join(masks.cameras)}
    drive = _with_motion(options, drive, masks)
    return MapRequest(drive, masks, frames, options.settings, options.start, options.base, not options.no_loops, kept)


def _masks_of(options: Options, drive: "Drive") -> str:
    """The name of the masks: those asked for, else the best that there are."""
    from semloc_jax.errors import UsageError
    from semloc_jax.inputs.mask_files import CLASSICAL
    from semloc_jax.inputs.mask_source import TOP_VIEW

    if options.front == CLASSICAL and options.masks not in (None, CLASSICAL):
        raise UsageError(f"--front {CLASSICAL} with --masks {options.masks}: choose one of them")
    best = CLASSICAL if options.front == CLASSICAL or not drive.mask_sources else drive.mask_sources[0]
    name = options.masks or best
    if name.startswith(TOP_VIEW):
        raise UsageError(f"--masks {name}: a map is made from the masks of cameras; give {name[len(TOP_VIEW) :]}")
    return name


def _with_motion(options: Options, drive: "Drive", masks: "MaskSource") -> "Drive":
    """The drive with the motion that is asked for."""
    from semloc_jax.localization.motion_source import resolved, with_seen_speed

    motion = resolved(drive, options.motion)
    return drive if motion == "wheels" else with_seen_speed(drive, masks, motion == "both")


def _beside(options: Options, request: "MapRequest", folder: Path) -> int:
    """Make the baseline and print it beside the map that is in the folder."""
    from semloc_jax.reports.literature import report_baseline

    print(f"\nthe way and its loops, beside those of the baseline {options.baseline}:")
    print(report_baseline(options.baseline, request.drive, request.masks, options.start, folder))
    print(f"results: {folder}")
    return OK
