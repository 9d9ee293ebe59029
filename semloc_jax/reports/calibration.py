"""The report of a calibration by a drive: what `semloc calibrate` writes (room: reports; host).

In: opened inputs or ground points. Out: corrected calibration, tables, pictures, text.
"""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from semloc_jax import viz
from semloc_jax.calibration import SelfCalibration, SelfCalibrationConfig, self_calibrate
from semloc_jax.calibration.ground_points import GroundPointConfig, calibrate_on_ground, read_ground_pairs
from semloc_jax.calibration.report import (
    ground_text,
    report_text,
    road_text,
    write_ground_report,
    write_report,
    write_road_report,
)
from semloc_jax.calibration.road_calibration import calibrate_on_road
from semloc_jax.calibration.road_fit import RoadCalibrationConfig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory, read_trajectory
from semloc_jax.inputs.drive_inputs import Inputs
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.pictures import calibration_panels
from semloc_jax.storage import output_path
from semloc_jax.viz.self_calibration import observability_figure, seen_lines_figure


def report_calibration(
    inputs: Inputs,
    source: Path,
    settings: SelfCalibrationConfig | None = None,
    reference: str | None = None,
    num_overlays: int = 4,
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> str:
    """Calibrate cameras by a drive, write everything, and return the text for people.

    Args:
        inputs: Drive, map, masks and prior.
        source: The calibration that the drive came with; the corrected one keeps its layout and keys.
        reference: `truth` or a trajectory file: poses of the vehicle from elsewhere.
        num_overlays: Number of before/after pictures, spread over the frames.

    Raises:
        SemlocError: the drive has no truth that `reference` asks for, or there is no such file.
    """
    settings, started = settings or SelfCalibrationConfig(), time.perf_counter()
    poses = _reference(reference, inputs)
    folder = make_folder(out)
    num = min(settings.num_frames, len(inputs.drive))
    given = (inputs.drive, inputs.map, inputs.masks, inputs.prior, settings, poses)
    with tqdm(total=num, unit="frame", desc="start poses", disable=None) as bar:
        result = self_calibrate(*given, on_frame=lambda found: bar.update())
    files = write_report(result, source, folder)
    write_record(folder, settings, options or {})
    _write_pictures(folder, inputs, result, num_overlays)
    done = f"calibrated in {time.perf_counter() - started:.0f} s: {', '.join(map(str, files))}"
    return "\n".join([report_text(result), done, f"results: {folder}"])


def report_road_calibration(
    drive: Drive,
    masks: MaskSource,
    source: Path,
    settings: SelfCalibrationConfig | None = None,
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> str:
    """Calibrate cameras by a drive without a map, write everything, and return the text for people.

    Args:
        drive: Frames, wheels and the calibration to start from.
        masks: Masks of its cameras.
        source: The calibration that the drive came with; the corrected one keeps its layout and keys.
    """
    settings = settings or SelfCalibrationConfig()
    result = calibrate_on_road(drive, masks, RoadCalibrationConfig(calibration=settings))
    folder = make_folder(out)
    files = write_road_report(result, source, folder)
    write_record(folder, settings, options or {})
    viz.save(observability_figure(result.observability), folder / "observability.png")
    viz.save(seen_lines_figure(result), folder / "lines.png")
    return f"{road_text(result)}\ncorrected: {', '.join(map(str, files))}\nresults: {folder}"


def report_ground_calibration(source: Path, points: Path, intrinsics: str, out: Path | None = None) -> str:
    """Calibrate the cameras of a surround view by points that two of them see; returns the text for people.

    Args:
        source: The calibration to correct.
        points: Table camera_a,u_a,v_a,camera_b,u_b,v_b [px].
        intrinsics: Which intrinsics are estimated, as in the configuration.
    """
    pairs, rig = read_ground_pairs(points), read_calibration(source)
    folder = make_folder(out)
    result = calibrate_on_ground(rig, pairs, GroundPointConfig(intrinsics=intrinsics))
    files = write_ground_report(result, source, folder)
    return f"{ground_text(result)}\ncorrected: {', '.join(map(str, files))}"


def _reference(text: str | None, inputs: Inputs) -> Trajectory | None:
    if text is None:
        return None
    if text != "truth":
        return read_trajectory(text)
    if inputs.drive.truth is None:
        raise SemlocError(
            f"drive {inputs.drive.name}: has no truth for --reference truth; give --reference FILE.tum, or leave it "
            "out: then the position of the cameras along and across the vehicle stays at its prior"
        )
    return inputs.drive.truth


def _write_pictures(folder: Path, inputs: Inputs, result: SelfCalibration, count: int) -> None:
    """Sigmas before and after, and the map on some frames with the old and the new calibration."""
    viz.save(observability_figure(result.observability), folder / "observability.png")
    if count < 1:
        return
    for index in np.unique(np.linspace(0, len(result.frames) - 1, count).astype(int)):
        frame, T_map_base = result.frames[index], result.T_map_base[index]
        panels = calibration_panels(inputs.map, inputs.masks, frame, T_map_base, result.rig_before, result.rig)
        figure = viz.before_after(panels, "before: calibration as given", "after: calibrated by the drive")
        viz.save(figure, output_path(folder, "overlays", frame.id, suffix=".png"))
