"""The report of frames that were localized one by one: what `semloc localize` writes (room: reports; host).

In: opened inputs, a configuration. Out: the results, and a folder with trajectory, tables, metrics and pictures.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.datasets import Frame
from semloc_jax.inputs.drive_inputs import Inputs
from semloc_jax.localization import frame_by_frame
from semloc_jax.maps import write_drive_geojson
from semloc_jax.reports import localize_log, run_inputs
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.metrics import shift_text, shifts, truth_of, write_metrics_of
from semloc_jax.reports.tables import write_tables
from semloc_jax.runtime.effort import effort_for

_NUM_NAMED = 5
"""So many frames that were not localized are named in the text."""


class FramesReport(NamedTuple):
    """Frames that were localized.

    Args:
        results: one for each frame.
        folder: where everything was written.
        text: metrics and summary for people.
    """

    results: list[LocalizationResult]
    folder: Path
    text: str

    @property
    def localized_share(self) -> float:
        """Share of the frames that were localized."""
        return sum(result.localized for result in self.results) / len(self.results)


def report_frames(
    inputs: Inputs,
    chosen: slice = slice(None),
    settings: LocalizeConfig | None = None,
    out: Path | None = None,
    num_overlays: int = 6,
    options: Mapping[str, Any] | None = None,
    resume: Path | None = None,
    localizer: frame_by_frame.SingleFrameLocalizer | None = None,
) -> FramesReport:
    """Localize frames one by one and write everything about them.

    Args:
        inputs: Drive, map, masks and prior.
        chosen: Which frames.
        settings: How a frame is localized; None for the defaults.
        num_overlays: Number of before/after pictures, spread over the frames.
        localizer: What places a frame; None for a `FrameLocalizer` with the settings.
    """
    settings = settings or LocalizeConfig()
    frames = inputs.drive.frames[chosen]
    folder = make_folder(out, resume)
    if resume is None:  # old results go before the folder says what this run began with
        localize_log.begin(folder)
    run_inputs.begun(folder, run_inputs.fingerprint(inputs, settings, options or {}), is_resumed=resume is not None)
    if inputs.is_map_made:
        write_drive_geojson(inputs.map, folder / "map.geojson")
    started = time.perf_counter()
    found = localize_log.read(folder, frames)
    try:
        with effort_for(len(frames)):
            for result in _rest(inputs, frames, settings, found, localizer):
                localize_log.append(folder, result)
                found.append(result)
    except KeyboardInterrupt:
        write_tables(found, truth_of(inputs.drive, found), folder)
        raise
    wall_s = time.perf_counter() - started
    truth = truth_of(inputs.drive, found)
    write_tables(found, truth, folder)
    write_record(folder, settings, options or {})
    lines = [write_metrics_of(found, truth, folder)] if truth else []
    if num_overlays > 0:
        from semloc_jax.reports import pictures

        pictures.write_overlays(folder, inputs.map, inputs.masks, found, num_overlays)
    lines.append(summary(found, wall_s))
    if (shift := shift_text(shifts(found))) is not None:
        lines.append(shift)
    return FramesReport(found, folder, "\n".join(lines))


def _rest(
    inputs: Inputs,
    frames: Sequence[Frame],
    settings: LocalizeConfig,
    found: Sequence[LocalizationResult],
    localizer: frame_by_frame.SingleFrameLocalizer | None,
) -> Iterator[LocalizationResult]:
    """Results of the frames that have none yet, with a progress bar on a terminal."""
    done = {result.frame.id for result in found}
    left = [frame for frame in frames if frame.id not in done]
    if done and not left:
        return
    with tqdm(total=len(frames), initial=len(done), unit="frame", disable=None) as bar:
        parts = inputs.drive, inputs.map, inputs.masks, inputs.prior
        for result in frame_by_frame.iterate_frames(*parts, left, inputs.masks.cameras, settings, localizer):
            bar.update()
            yield result


def summary(found: Sequence[LocalizationResult], wall_s: float) -> str:
    """How many frames were localized, how long it took, and which were not."""
    num = sum(result.localized for result in found)
    frame_s = [sum(result.times.values()) for result in found]
    lines = [f"localized {num} of {len(found)} frames in {wall_s:.1f} s"]
    if len(found) > 1:
        rest_ms = 1e3 * np.median(frame_s[1:])
        lines.append(f"first frame {frame_s[0]:.1f} s with compilation, then {rest_ms:.0f} ms each")
    lost = [result for result in found if not result.localized]
    lines += [f"not localized: frame {r.frame.id} ({r.status.name}: {'; '.join(r.reasons)})" for r in lost[:_NUM_NAMED]]
    if len(lost) > _NUM_NAMED:
        lines.append(f"... and {len(lost) - _NUM_NAMED} more, see frames.csv")
    return "\n".join(lines)
