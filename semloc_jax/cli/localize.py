"""`semloc localize`: where was the vehicle in each frame of a drive (room: cli)."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from semloc_jax.cli.drive_options import FleetOptions, run_each
from semloc_jax.cli.main import LOST, OK, log_to_console
from semloc_jax.inputs.choices import parse_slice
from semloc_jax.inputs.drive_inputs import Inputs, open_inputs

if TYPE_CHECKING:
    from semloc_jax.alignment.frame_localizer import LocalizeConfig
    from semloc_jax.alignment.point_localizer import PointLocalizer


@dataclass(frozen=True)
class Options(FleetOptions):
    """Localize frames of a drive in a map, each on its own, and judge every pose.

    Writes trajectory.tum (localized frames), frames.csv (every frame with its status), hypotheses.csv (every mode),
    results.jsonl (line by line, for --resume after a kill), metrics.json where the drive has a truth, config.yaml
    (resolved; reads back with --config) and overlays/*.png.

    Every value of the configuration is an option too, e.g. --verdict.max-cost 0.6: 'semloc config' prints them all.
    The exit code is 3 when the share of localized frames is below --min-localized-share.
    """

    frames: str = ":"
    """Which frames, as a Python slice: ::5, 10:20, 7."""
    method: Literal["search", "icp"] = "search"
    """search: ours. icp: a baseline of the literature: contours of the masks in the top view are matched to the nearest
    points of the map, starting at the prior; one pose, a simple verdict, no configuration."""
    ipm_points: Path | None = None
    """For --method icp: the top view of a camera by four points instead of the calibration: a csv file with the columns
    camera, u_px, v_px, x_m, y_m (on the road, forward and left of the rear axle), four rows for each camera."""
    hypotheses: int | None = None
    """Start poses of the search; default: that of the configuration."""
    min_localized_share: float = 0.5
    """Exit code 3 below this share of localized frames."""
    overlays: int = 6
    """Number of before/after pictures, spread over the frames; 0 for none."""
    fault: str | None = None
    """Run the hostile suite: a fault (focal, lines_repainted:3), a family (map, calibration, gnss, masks), a list with
    commas, or all, for faults.csv and faults.md, worst first; --resume DIR goes on with it after a kill. The exit code
    then is 3 where a frame was localized at a wrong place."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    resume: Path | None = None
    """Folder of a run that was killed: go on where it stopped."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "LocalizeConfig":
    """The default configuration of single frames."""
    from semloc_jax.alignment.frame_localizer import LocalizeConfig

    return LocalizeConfig()


def run(options: Options) -> int:
    """Localize, print how good it is."""
    from semloc_jax.reports.frames import report_frames

    log_to_console()
    if options.others:
        return run_each("localize", options)
    chosen = parse_slice(options.frames)
    inputs = open_inputs(options)
    settings = configured(options, options.settings)
    localizer = _by_points(options, inputs)
    if options.fault is not None:
        return _faults(options, inputs, chosen, settings)
    report = report_frames(
        inputs, chosen, settings, options.out, options.overlays, options.kept(inputs), options.resume, localizer
    )
    print(report.text)
    print(f"results: {report.folder}")
    return OK if report.localized_share >= options.min_localized_share else LOST


def _by_points(options: Options, inputs: Inputs) -> "PointLocalizer | None":
    """The localizer of the literature, where it is asked for."""
    from semloc_jax.errors import SemlocError, UsageError

    if options.method != "icp":
        if options.ipm_points is not None:
            raise UsageError("--ipm-points: only --method icp takes a top view by four points; give both")
        return None
    if options.fault is not None:
        raise UsageError("--method icp with --fault: the hostile suite judges the search; choose one of them")
    from semloc_jax.alignment.point_localizer import PointLocalizer
    from semloc_jax.perception.road_projection import read_four_points

    roads = read_four_points(options.ipm_points) if options.ipm_points is not None else {}
    other = [name for name in roads if name not in inputs.masks.cameras]
    if other:
        raise SemlocError(
            f"--ipm-points {options.ipm_points}: points of camera {other[0]}; expected cameras of the masks: "
            f"{', '.join(inputs.masks.cameras)}"
        )
    return PointLocalizer(inputs.map, inputs.masks.table, roads=roads)


def _faults(options: Options, inputs: Inputs, chosen: slice, settings: "LocalizeConfig") -> int:
    from semloc_jax.inputs.priors import prior_source
    from semloc_jax.reports.frame_faults import report_frame_faults

    kind = options.prior or "gnss"
    sigmas = options.prior_sigma_xy_m, options.prior_sigma_yaw_deg
    folder, table, false = report_frame_faults(
        inputs,
        options.fault,
        lambda drive: prior_source(kind, drive, *sigmas, options.seed),
        chosen,
        settings,
        options.out,
        options.kept(inputs),
        options.seed,
        options.resume,
    )
    print(table)
    print(f"results: {folder}")
    return OK if false == 0 else LOST


def configured(options: Options, settings: "LocalizeConfig") -> "LocalizeConfig":
    """The configuration with the verb's own options in it."""
    num = settings.search.num_hypotheses if options.hypotheses is None else options.hypotheses
    search = dataclasses.replace(settings.search, num_hypotheses=num, seed=options.seed)
    return dataclasses.replace(settings, search=search)
