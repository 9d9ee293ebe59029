"""`semloc track`: follow the vehicle through a whole drive (room: cli)."""

import dataclasses
import functools
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from semloc_jax.cli.drive_options import DriveOptions
from semloc_jax.cli.main import LOST, OK
from semloc_jax.inputs.choices import parse_slice
from semloc_jax.inputs.drive_inputs import Inputs, open_inputs

if TYPE_CHECKING:
    from semloc_jax.fusion.measurements import Fusion
    from semloc_jax.fusion.prediction import MotionLog
    from semloc_jax.localization.checkpoint import Checkpoint
    from semloc_jax.localization.localizer import Localizer, TrackConfig
    from semloc_jax.localization.pipeline import Pipeline
    from semloc_jax.maps import SemanticMap
    from semloc_jax.reports.track_log import TrackTable

CHECKPOINT = "state.npz"
ALL_FUSIONS = "all"


@dataclass(frozen=True)
class Options(DriveOptions):
    """Follow the vehicle through a drive: initialise, track, know when lost, recover.

    Writes frames.csv (line by line while driving), trajectory.tum, metrics.json, tracking.png, stanford.png,
    map_changes.csv, config.yaml, overlays/*.png and state.npz, from which --resume goes on after a kill.

    --prior gnss starts from the first satellite fixes; truth or a trajectory file give a first guess where there are
    none. The exit code is 3 when the vehicle is lost at the end, or tracked for less than --min-tracking-share.
    """

    frames: str = ":"
    """Which frames, as a Python slice: ::2, 10:60."""
    fusion: Literal["window", "dropping", "kalman", "single", "all"] = "window"
    """How poses become one over time: sliding-window graph, one that drops its oldest state, Kalman filter, each frame
    alone; or all of them on the same features, for fusions.csv and fusions.md."""
    area: str | None = None
    """X,Y,RADIUS in the map: where to search when neither fixes nor a prior are given."""
    no_gnss_after_init: bool = False
    """Use satellite fixes to initialise only."""
    fault: str | None = None
    """Disturb the drive: gnss_dropout, black_images, kidnapped ... or all of them, for faults.csv and faults.md."""
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
    """How a drive is followed if nothing is said."""
    from semloc_jax.localization.localizer import TrackConfig

    return TrackConfig()


def run(options: Options) -> int:
    """Track, write everything, say how good it is; returns the exit code."""
    from semloc_jax.reports import results, track_faults
    from semloc_jax.reports.track_log import TrackLog, TrackTable

    logging.basicConfig(format="%(message)s")
    logging.getLogger("semloc_jax").setLevel(logging.INFO)
    chosen = parse_slice(options.frames)
    inputs = _open(options)
    folder = options.resume or results.make_folder(options.out)
    if options.fault == track_faults.ALL:
        return _try_faults(options, inputs, folder)
    if options.fault is not None:
        inputs = track_faults.disturbed(inputs, options.fault, options.seed)
    frames = list(inputs.drive.frames[chosen])
    if options.fusion == ALL_FUSIONS:
        return _compare_fusions(options, inputs, frames, folder)
    pipeline = _pipeline(options, inputs)
    start = _checkpoint(options, pipeline)
    results.write_record(folder, options.settings, _options_to_keep(options, inputs))
    log = TrackLog(folder, inputs.drive, keep=start.next_frame if start else 0)
    try:
        last = _drive(pipeline, frames, start, log, folder / CHECKPOINT)
    finally:
        log.close()
    return _finish(options, inputs, pipeline, TrackTable.read(folder), last, folder)


def _open(options: Options) -> Inputs:
    """The drive and the rest; without fixes and without a wish the area, or nothing, says where to start."""
    from semloc_jax.datasets import open_drive
    from semloc_jax.errors import SemlocError

    if options.prior is None and open_drive(options.drive, options.calib).gnss is None:
        if options.area is None:
            raise SemlocError(
                f"drive {options.drive}: has no satellite fixes to start from; give --prior truth, --prior FILE.tum or "
                "--area X,Y,RADIUS"
            )
        options = dataclasses.replace(options, prior="truth")  # nothing asks for it: the area says where to start
    return open_inputs(options)


def _pipeline(options: Options, inputs: Inputs) -> "Pipeline":
    from semloc_jax.fusion.prediction import MotionLog
    from semloc_jax.localization.pipeline import Pipeline, PipelineConfig

    has_guess = options.prior not in (None, "gnss")
    localizer = _localizer(options, inputs, inputs.map, MotionLog.of_drive(inputs.drive))
    config = PipelineConfig(realtime=options.realtime, gnss_after_init=not options.no_gnss_after_init)
    return Pipeline(inputs.drive, inputs.masks, localizer, config, inputs.prior if has_guess else None)


def _localizer(options: Options, inputs: Inputs, semantic_map: "SemanticMap", motion: "MotionLog") -> "Localizer":
    from semloc_jax.localization.localizer import Localizer

    table, area = inputs.masks.table, _area(options.area)
    return Localizer(semantic_map, table, motion, _fusion(options.fusion), options.settings, area)


def _try_faults(options: Options, inputs: Inputs, folder: Path) -> int:
    """Every fault in turn; the exit code is 3 where a frame is called tracked and is not."""
    from semloc_jax.reports import results, track_faults

    results.write_record(folder, options.settings, _options_to_keep(options, inputs))
    make = functools.partial(_localizer, options, inputs)
    num_false = track_faults.write_matrix(inputs, make, folder, options.seed)
    print(f"results: {folder}")
    return LOST if num_false else OK


def _compare_fusions(options: Options, inputs: Inputs, frames: list, folder: Path) -> int:
    """Every fusion on the same features; the exit code is 3 where one calls a frame tracked that is not."""
    from tqdm import tqdm

    from semloc_jax.reports import results, track_fusions

    results.write_record(folder, options.settings, _options_to_keep(options, inputs))
    progress = functools.partial(tqdm, unit="frame", disable=None)
    chosen = {name: _pipeline(dataclasses.replace(options, fusion=name), inputs) for name in track_fusions.FUSIONS}
    rows = track_fusions.write_comparison(chosen, frames, folder, progress)
    print(track_fusions.to_markdown(rows))
    print(f"results: {folder}")
    return LOST if any(row.false for row in rows) else OK


def _fusion(name: str) -> "Fusion":
    from semloc_jax.reports.track_fusions import FUSIONS

    # With a matrix of faults there is no table of fusions: the window stands for all.
    return FUSIONS["window" if name == ALL_FUSIONS else name]()


def _area(text: str | None):
    from semloc_jax.errors import UsageError
    from semloc_jax.localization.acquisition import Area

    if text is None:
        return None
    try:
        x, y, radius = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"--area '{text}': expected X,Y,RADIUS in metres, e.g. 12.5,-3,20") from error
    return Area(x, y, radius)


def _checkpoint(options: Options, pipeline: "Pipeline") -> "Checkpoint | None":
    from semloc_jax.localization import checkpoint

    if options.resume is None:
        return None
    return checkpoint.load(options.resume / CHECKPOINT, pipeline.localizer.template())


def _drive(pipeline: "Pipeline", frames: list, start: "Checkpoint | None", log, path: Path) -> "Checkpoint | None":
    """Run through the frames; every line is on disk before the state that follows it."""
    from tqdm import tqdm

    from semloc_jax.localization import checkpoint

    by_id = {frame.id: frame for frame in frames}
    last = start
    with tqdm(total=len(frames), initial=start.next_frame if start else 0, unit="frame", disable=None) as bar:

        def on_frame(at: "Checkpoint", result) -> None:
            nonlocal last
            log.append(by_id[result.frame_id], result)
            checkpoint.save(at, path)
            last = at
            bar.update()

        for _ in pipeline.run(frames, start, on_frame):
            pass
    return last


def _finish(
    options: Options, inputs: Inputs, pipeline: "Pipeline", table: "TrackTable", last: "Checkpoint | None", folder: Path
) -> int:
    """Write what follows from the table, print a summary, and return the exit code."""
    from semloc_jax.evaluation import write_tum
    from semloc_jax.localization.track_state import TrackStatus
    from semloc_jax.reports import track_metrics, track_pictures

    write_tum(table.trajectory(), folder / "trajectory.tum")
    print(track_metrics.write_track_metrics(folder, table, inputs.drive, pipeline.timing))
    if last is not None:
        _write_map_changes(folder / "map_changes.csv", pipeline, last)
    track_pictures.write_timeline(folder, table)
    track_pictures.write_stanford(folder, table)
    overlay = track_pictures.Overlay(inputs.map, inputs.masks, table)
    shown = [frame for frame in inputs.drive.frames if frame.id in set(table.frames)]
    track_pictures.write_strip(folder, overlay, shown, options.overlays)
    if options.video and len(shown) > 1:
        rate_hz = (len(shown) - 1) / (shown[-1].time_s - shown[0].time_s)
        track_pictures.write_video(folder / "track.mp4", overlay, shown, rate_hz)
    if options.rrd is not None:
        track_pictures.write_rrd(options.rrd, inputs.map, inputs.drive, overlay, shown)
    print(track_metrics.summary(table, pipeline.timing))
    print(f"results: {folder}")
    is_lost = not len(table) or table.status[-1] == TrackStatus.LOST
    return LOST if is_lost or table.is_tracking.mean() < options.min_tracking_share else OK


def _write_map_changes(path: Path, pipeline: "Pipeline", last: "Checkpoint") -> None:
    from semloc_jax.localization.map_faults import MapChange, map_changes
    from semloc_jax.reports.results import write_csv

    localizer = pipeline.localizer
    write_csv(path, MapChange._fields, map_changes(last.state.trust, localizer.map, localizer.config.trust))


def _options_to_keep(options: Options, inputs: Inputs) -> dict:
    """Options that a configuration file may hold, with their defaults resolved."""
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(Options)}
    resolved = {"masks": inputs.masks.name, "cameras": ",".join(inputs.masks.cameras)}
    dropped = ("drive", "config", "out", "resume", "rrd")
    kept = {key: value for key, value in (given | resolved).items() if key not in dropped and value is not None}
    return {key: value for key, value in kept.items() if value is not False}
