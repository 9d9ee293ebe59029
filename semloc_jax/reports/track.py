"""The report of a tracked drive: what `semloc track` writes (room: reports; host).

In: opened inputs, how the drive is followed. Out: frames.csv line by line while driving, then everything from it.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from semloc_jax.datasets import Frame, open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import write_tum
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.inputs.drive_inputs import InputOptions, Inputs, open_inputs
from semloc_jax.inputs.priors import other_priors
from semloc_jax.localization import checkpoint
from semloc_jax.localization.acquisition import Area
from semloc_jax.localization.checkpoint import Checkpoint
from semloc_jax.localization.localizer import Localizer, TrackConfig
from semloc_jax.localization.motion_source import Motion, motion_log
from semloc_jax.localization.pipeline import Pipeline, PipelineConfig
from semloc_jax.localization.track_state import TrackStatus
from semloc_jax.maps import SemanticMap
from semloc_jax.reports import (
    fault_tables,
    run_inputs,
    track_faults,
    track_fusions,
    track_log,
    track_metrics,
    track_pictures,
)
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.map_changes import write_map_changes
from semloc_jax.reports.track_fusions import FUSIONS
from semloc_jax.reports.track_log import TrackLog, TrackTable
from semloc_jax.runtime.effort import effort_for

CHECKPOINT = "state.npz"
_SAVED_S = 0.5
"""A kill loses so much work, and its frames are driven anew; a state takes as long to write as a window to solve."""


@dataclass(frozen=True)
class TrackPlan:
    """How a drive is followed.

    Args:
        settings: The configuration of the tracker.
        fusion: How poses become one over time: a name of FUSIONS.
        motion: What says how the vehicle moved between frames, see `motion_source.resolved`.
        area: Where to search when neither fixes nor a prior are given; in the map.
        has_guess: Start from the prior of the inputs instead of the first satellite fixes.
        gnss_after_init: Whether satellite fixes are used once the vehicle was tracked.
        realtime: Play the drive at its own pace; frames that come too fast are dropped.
        seed: Of the noise of faults.
    """

    settings: TrackConfig
    fusion: str = "window"
    motion: Motion = "wheels"
    area: Area | None = None
    has_guess: bool = False
    gnss_after_init: bool = True
    realtime: bool = False
    seed: int = 0

    def localizer(self, inputs: Inputs, semantic_map: SemanticMap, motion: MotionLog) -> Localizer:
        """The tracker of a drive in a map."""
        return Localizer(semantic_map, inputs.masks.table, motion, FUSIONS[self.fusion](), self.settings, self.area)

    def pipeline(self, inputs: Inputs) -> Pipeline:
        """The drive, its masks and the tracker."""
        localizer = self.localizer(inputs, inputs.map, motion_log(inputs.drive, self.motion, inputs.masks))
        config = PipelineConfig(realtime=self.realtime, gnss_after_init=self.gnss_after_init)
        return Pipeline(inputs.drive, inputs.masks, localizer, config, inputs.prior if self.has_guess else None)


class TrackPictures(NamedTuple):
    """What is drawn.

    Args:
        num_overlays: number of pictures, spread over the drive.
        has_video: whether track.mp4 is written.
        rrd: where a recording for Rerun is written; None for none.
    """

    num_overlays: int = 6
    has_video: bool = False
    rrd: Path | None = None


class TrackReport(NamedTuple):
    """A tracked drive.

    Args:
        folder: where everything was written.
        text: metrics and summary for people.
        tracking_share: share of frames called TRACKING.
        is_lost: whether the vehicle is lost at the end.
    """

    folder: Path
    text: str
    tracking_share: float
    is_lost: bool


def open_tracked(options: InputOptions, has_area: bool = False) -> Inputs:
    """The drive and the rest; without fixes and prior the area says where to start.

    Raises:
        SemlocError: nothing says where to start, or something cannot be read.
    """
    if options.prior is None and (drive := open_drive(options.drive, options.calib)).gnss is None:
        if not has_area:
            raise SemlocError(
                f"drive {options.drive}: has no satellite fixes to start from; give {other_priors(drive)}, or "
                "--area X,Y,RADIUS"
            )
        options = replace(options, prior="truth")  # never asked: the area says where to start
    return open_inputs(options)


def report_track(
    inputs: Inputs,
    plan: TrackPlan,
    frames: Sequence[Frame],
    out: Path | None = None,
    pictures: TrackPictures | None = None,
    resume: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> TrackReport:
    """Follow the vehicle through the frames and write everything about it.

    Args:
        inputs: Drive, map, masks and prior.
        plan: How the drive is followed.
        frames: In time order.
        pictures: What is drawn; None for the defaults.
    """
    if not frames:
        raise SemlocError(f"drive {inputs.drive.name}: no frames chosen of {len(inputs.drive)}; check --frames")
    folder = make_folder(out, resume)
    parts = run_inputs.fingerprint(inputs, (plan.settings, plan.area), options or {})
    if resume is None:  # an old state goes before the folder says what this run began with
        (folder / CHECKPOINT).unlink(missing_ok=True)
    run_inputs.begun(folder, parts, is_resumed=resume is not None)
    pipeline = plan.pipeline(inputs)
    start = _start(folder, frames, pipeline, plan) if resume is not None else None
    write_record(folder, plan.settings, options or {})
    log = TrackLog(folder, inputs.drive, keep=start.next_frame if start else 0)
    try:
        with effort_for(len(frames)):
            last = _drive(pipeline, frames, start, log, folder / CHECKPOINT)
    finally:
        log.close()
    table = TrackTable.read(folder)
    write_tum(table.trajectory(), folder / "trajectory.tum")
    text = track_metrics.write_track_metrics(folder, table, inputs.drive, pipeline.timing)
    if last is not None:
        localizer = pipeline.localizer
        write_map_changes(folder, table, last.state.trust, localizer.map, localizer.config.trust)
    _draw(folder, inputs, table, pictures or TrackPictures())
    is_lost = not len(table) or table.status[-1] == TrackStatus.LOST
    share = float(table.is_tracking.mean()) if len(table) else 0.0
    apart = track_metrics.told_apart(table, pipeline.localizer.map, plan.settings.scene)
    told = [part for part in (text, apart, track_metrics.summary(table, pipeline.timing)) if part]
    return TrackReport(folder, "\n".join(told), share, is_lost)


def _start(folder: Path, frames: Sequence[Frame], pipeline: Pipeline, plan: TrackPlan) -> Checkpoint | None:
    """Where a run that is resumed stood; None where it was killed before its first frame was done.

    Raises:
        SemlocError: the state, the table and the frames do not belong together.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        return None
    found = checkpoint.load(path, pipeline.localizer.template())
    if found.next_frame > len(frames):
        raise SemlocError(
            f"--resume {folder}: {found.next_frame} frames are done and the drive has {len(frames)}; resume with the "
            "drive of the run"
        )
    if not plan.realtime:  # which drops frames
        track_log.require_lines(folder, frames[: found.next_frame], f"--resume {folder}")
    return found


def _drive(
    pipeline: Pipeline, frames: Sequence[Frame], start: Checkpoint | None, log: TrackLog, path: Path
) -> Checkpoint | None:
    """Run through the frames; every line is on disk before the state that follows it, see `_SAVED_S`."""
    by_id = {frame.id: frame for frame in frames}
    last, saved, saved_s = start, start, time.monotonic()
    every_s = 0.0 if pipeline.config.realtime else _SAVED_S  # which frames are driven anew depends on the clock there
    with tqdm(total=len(frames), initial=start.next_frame if start else 0, unit="frame", disable=None) as bar:

        def on_frame(at: Checkpoint, result: Any) -> None:
            nonlocal last, saved, saved_s
            log.append(by_id[result.frame_id], result)
            last = at
            if time.monotonic() - saved_s >= every_s:
                checkpoint.save(at, path)
                saved, saved_s = at, time.monotonic()
            bar.update()

        try:
            for _ in pipeline.run(frames, start, on_frame):
                pass
        finally:
            if last is not saved:
                checkpoint.save(last, path)
    return last


def _draw(folder: Path, inputs: Inputs, table: TrackTable, wanted: TrackPictures) -> None:
    track_pictures.write_timeline(folder, table)
    track_pictures.write_stanford(folder, table)
    overlay = track_pictures.Overlay(inputs.map, inputs.masks, table)
    known = set(table.frames)
    shown = [frame for frame in inputs.drive.frames if frame.id in known]
    track_pictures.write_strip(folder, overlay, shown, wanted.num_overlays)
    if wanted.has_video and len(shown) > 1:
        rate_hz = (len(shown) - 1) / (shown[-1].time_s - shown[0].time_s)
        track_pictures.write_video(folder / "track.mp4", overlay, shown, rate_hz)
    if wanted.rrd is not None:
        track_pictures.write_rrd(wanted.rrd, inputs.map, inputs.drive, overlay, shown)


def report_faults(
    inputs: Inputs,
    plan: TrackPlan,
    wanted: str,
    chosen: slice = slice(None),
    out: Path | None = None,
    resume: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> tuple[Path, str, int]:
    """Track a part of the drive with every fault in turn; returns the folder, the table and the number of false frames.

    A frame is false where it is called TRACKING with an error beyond one of its protection levels.

    Args:
        inputs: Drive, map and masks.
        plan: How the drive is followed.
        wanted: Which faults, see `simulation.hostile.suite`.
        chosen: Which frames; the faults are put into these.
    """
    from semloc_jax.simulation.hostile import suite

    rows = suite(wanted)
    frames = inputs.drive.frames[chosen]
    if len(frames) < 2 or inputs.drive.truth is None:
        raise SemlocError(
            f"drive {inputs.drive.name}: {len(frames)} frames chosen of {len(inputs.drive)}, "
            f"{'no' if inputs.drive.truth is None else 'with'} truth; faults are judged against a truth over several "
            "frames"
        )
    folder = make_folder(out, resume)
    kept = options or {}
    parts = run_inputs.fingerprint(inputs, (plan.settings, plan.area, str(chosen)), kept)
    run_inputs.begun(folder, parts, is_resumed=resume is not None)
    if resume is None:  # rows of an earlier suite in this folder are of another run
        for name in (fault_tables.TABLE, track_faults.FRAMES):
            (folder / name).unlink(missing_ok=True)
    write_record(folder, plan.settings, kept)
    inputs = replace(inputs, drive=replace(inputs.drive, frames=frames))
    make: Callable = partial(plan.localizer, inputs)
    return folder, *track_faults.write_suite(inputs, make, rows, folder, plan.seed)


def report_fusions(
    inputs: Inputs,
    plan: TrackPlan,
    frames: Sequence[Frame],
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> tuple[Path, str, int]:
    """Track with every fusion on the same features; returns the folder, the table and the number of false frames."""
    folder = make_folder(out)
    write_record(folder, plan.settings, options or {})
    pipelines = {name: replace(plan, fusion=name).pipeline(inputs) for name in FUSIONS}
    rows = track_fusions.write_comparison(pipelines, frames, folder, partial(tqdm, unit="frame", disable=None))
    return folder, track_fusions.to_markdown(rows), sum(row.false for row in rows)
