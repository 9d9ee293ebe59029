"""`semloc calibrate`: cameras, odometer and satellite offset from a drive, and what it cannot tell (room: cli)."""

import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_jax.cli.drive_options import DriveOptions
from semloc_jax.cli.main import OK
from semloc_jax.inputs.drive_inputs import Inputs, open_inputs

if TYPE_CHECKING:
    from semloc_jax.calibration import SelfCalibration, SelfCalibrationConfig
    from semloc_jax.evaluation import Trajectory


@dataclass(frozen=True)
class Options(DriveOptions):
    """Calibrate the cameras of a vehicle from a drive through a map.

    Writes the corrected calibration (calib.yaml with the keys that it had), report.txt, observability.csv,
    calibration.json (odometer scale, gyroscope bias, GNSS offset, directions that are not observable), trajectory.tum,
    observability.png, overlays/*.png and config.yaml.

    What a drive cannot tell stays at its prior and is named. With --ground-points DRIVE is a calibration: its cameras
    are calibrated against each other, without drive and map.

    Every value of the configuration is an option too, e.g. --priors.mount-deg 1 or --intrinsics focal.
    """

    reference: str | None = None
    """Poses of the vehicle from elsewhere: truth, or a trajectory file in the frame of the map. They tell where on the
    vehicle the cameras sit, which a drive alone hardly can."""
    ground_points: Path | None = None
    """Table camera_a,u_a,v_a,camera_b,u_b,v_b: pixels of the same ground point in two cameras."""
    overlays: int = 4
    """Number of before/after pictures, spread over the frames; 0 for none."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "SelfCalibrationConfig":
    """How a drive is calibrated if nothing is said."""
    from semloc_jax.calibration import SelfCalibrationConfig

    return SelfCalibrationConfig()


def run(options: Options) -> int:
    """Calibrate, write everything, say what is known; returns the exit code."""
    from semloc_jax.calibration.report import report_text, write_report
    from semloc_jax.reports import results

    logging.basicConfig(format="%(message)s")
    logging.getLogger("semloc_jax").setLevel(logging.INFO)
    if options.ground_points is not None:
        return _on_ground(options)
    inputs = open_inputs(options)
    folder = results.make_folder(options.out)
    started = time.perf_counter()
    result = _calibrate(options, inputs)
    files = write_report(result, _source(options), folder)
    results.write_record(folder, options.settings, _options_to_keep(options, inputs))
    _write_pictures(folder, inputs, result, options.overlays)
    print(report_text(result))
    print(f"calibrated in {time.perf_counter() - started:.0f} s: {', '.join(map(str, files))}")
    print(f"results: {folder}")
    return OK


def _calibrate(options: Options, inputs: Inputs) -> "SelfCalibration":
    from tqdm import tqdm

    from semloc_jax.calibration import self_calibrate

    reference = _reference(options, inputs)
    num = min(options.settings.num_frames, len(inputs.drive))
    with tqdm(total=num, unit="frame", desc="start poses", disable=None) as bar:
        return self_calibrate(
            inputs.drive,
            inputs.map,
            inputs.masks,
            inputs.prior,
            options.settings,
            reference,
            on_frame=lambda result: bar.update(),
        )


def _reference(options: Options, inputs: Inputs) -> "Trajectory | None":
    """The trajectory that the option names.

    Raises:
        SemlocError: the drive has no truth, or there is no such file.
    """
    from semloc_jax.errors import SemlocError
    from semloc_jax.evaluation import read_trajectory

    if options.reference is None:
        return None
    if options.reference != "truth":
        return read_trajectory(options.reference)
    if inputs.drive.truth is None:
        raise SemlocError(
            f"drive {inputs.drive.name}: has no truth for --reference truth; give --reference FILE.tum, or leave it "
            "out: then where the cameras sit along and across the vehicle stays at its prior"
        )
    return inputs.drive.truth


def _source(options: Options) -> Path:
    """The calibration that was read."""
    return options.calib if options.calib is not None else options.drive


def _options_to_keep(options: Options, inputs: Inputs) -> dict:
    """Options that a configuration file may hold, with their defaults resolved."""
    import dataclasses

    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(Options)}
    resolved = {"masks": inputs.masks.name, "cameras": ",".join(inputs.masks.cameras)}
    dropped = ("drive", "config", "out")
    return {key: value for key, value in (given | resolved).items() if key not in dropped and value is not None}


def _write_pictures(folder: Path, inputs: Inputs, result: "SelfCalibration", count: int) -> None:
    """Sigmas before and after, and the map on some frames with the old and the new calibration."""
    import numpy as np

    from semloc_jax import viz
    from semloc_jax.reports.pictures import calibration_panels
    from semloc_jax.viz.self_calibration import observability_figure

    viz.save(observability_figure(result.observability), folder / "observability.png")
    if count < 1:
        return
    (folder / "overlays").mkdir(exist_ok=True)
    for index in np.unique(np.linspace(0, len(result.frames) - 1, count).astype(int)):
        frame, T_map_base = result.frames[index], result.T_map_base[index]
        panels = calibration_panels(inputs.map, inputs.masks, frame, T_map_base, result.rig_before, result.rig)
        figure = viz.before_after(panels, "before: calibration as given", "after: calibrated by the drive")
        viz.save(figure, folder / "overlays" / f"{frame.id}.png")


def _on_ground(options: Options) -> int:
    from semloc_jax.calibration.ground_points import GroundPointConfig, calibrate_on_ground, read_ground_pairs
    from semloc_jax.calibration.report import ground_text, write_ground_report
    from semloc_jax.cameras import read_calibration
    from semloc_jax.reports import results

    source = _source(options)
    pairs = read_ground_pairs(options.ground_points)
    rig = read_calibration(source)
    folder = results.make_folder(options.out)
    result = calibrate_on_ground(rig, pairs, GroundPointConfig(intrinsics=options.settings.intrinsics))
    files = write_ground_report(result, source, folder)
    print(ground_text(result))
    print(f"corrected: {', '.join(map(str, files))}")
    return OK
