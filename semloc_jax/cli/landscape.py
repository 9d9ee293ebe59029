"""`semloc landscape`: the cost around the pose of one frame, over two of the six directions (room: cli)."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from semloc_jax.cli.drive_options import DriveOptions
from semloc_jax.cli.main import OK
from semloc_jax.errors import UsageError
from semloc_jax.inputs.choices import parse_names
from semloc_jax.inputs.drive_inputs import Inputs, open_inputs

if TYPE_CHECKING:
    from semloc_jax.alignment.frame_localizer import LocalizeConfig
    from semloc_jax.datasets import Frame


@dataclass(frozen=True)
class Options(DriveOptions):
    """The cost around the pose of one frame, over two of the six directions, for all classes and for each alone.

    Shows what holds the pose and what does not: a valley is a direction that the class says nothing about, a second
    basin is a pose that it would confuse with the true one. Writes landscape.png and minima.csv.
    With --basin it measures from how far away the true pose is found and writes basin.png and basin.csv instead.
    With --search it draws instead which hypotheses each stage of the search from the prior leaves: search.png.
    With --serve it writes nothing: on a page in the browser one drags the pose on the map and sees overlay, residuals,
    slices of the cost, covariance and the path of the solver from there; Ctrl-C ends it.
    """

    frame: int = 0
    """Index of the frame."""
    over: str = "x,y"
    """Two of x, y, z (along, left, up), roll, pitch, yaw."""
    extent: str = "4,2"
    """Half width along each of the two [m or deg]."""
    steps: str = "81,61"
    """Number of poses along each of the two."""
    level: int = 1
    """Level of the cost maps: 0 is the coarsest."""
    around: Literal["truth", "prior"] = "truth"
    """The pose in the middle; the prior is taken where the drive has no truth."""
    basin: bool = False
    """Measure from where around the true pose a single start finds it, instead of slicing the cost."""
    starts: int = 512
    """Starts of the basin, drawn evenly."""
    window: str = "5,3,10"
    """Half widths of the window that they are drawn from: longitudinal [m], lateral [m], heading [deg]."""
    prove: bool = False
    """With --basin: also prove by interval bounds within which region no other pose fits as well; a minute."""
    search: bool = False
    """Draw the hypotheses that each stage of the search leaves, instead of slicing the cost."""
    serve: bool = False
    """Open the explorer, a page on this machine, instead of writing pictures."""
    port: int = 8765
    """Port of the explorer; 0 for any free one."""
    no_browser: bool = False
    """Do not open the browser, only say the address."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "LocalizeConfig":
    """The configuration of `semloc localize`."""
    from semloc_jax.alignment.frame_localizer import LocalizeConfig

    return LocalizeConfig()


def run(options: Options) -> int:
    """Compute the costs, draw them, list the minima; or serve the explorer."""
    if options.serve:
        return _serve(options)
    if options.basin:
        return _basin(options)
    if options.search:
        return _search(options)
    from semloc_jax import viz
    from semloc_jax.alignment.frame_localizer import FrameLocalizer
    from semloc_jax.reports import results
    from semloc_jax.viz.frame_slices import frame_slices

    directions, extents, steps = _grid(options)
    inputs = open_inputs(options)
    frame = inputs.frame(options.frame)
    is_truth = options.around == "truth" and inputs.drive.truth is not None
    T_map_base = inputs.drive.truth_at(frame) if is_truth else inputs.prior(frame).on_road(inputs.map)
    localizer = FrameLocalizer(inputs.map, inputs.masks.table, options.settings)
    rig = inputs.masks.seen_by(frame.rig.select(inputs.masks.cameras))
    around = (localizer, inputs.masks.masks(frame), rig, T_map_base)
    slices = frame_slices(*around, directions, extents, options.level, steps)

    folder = results.make_folder(options.out)
    ramp_px = options.settings.cost_maps.ramp_px[options.level]
    title = f"{inputs.drive.name} frame {frame.id}, masks {inputs.masks.name}, ramp {ramp_px:g} px"
    truth = (0.0, 0.0) if is_truth else None
    print(f"picture: {viz.save(viz.landscape(slices, title, truth), folder / 'landscape.png')}")
    rows = [
        (name, rank, f"{m.offset_a:.4f}", f"{m.offset_b:.4f}", f"{m.cost:.4f}")
        for name, piece in slices.items()
        for rank, m in enumerate(viz.find_minima(piece), start=1)
    ]
    results.write_csv(folder / "minima.csv", ("class", "rank", *directions, "cost"), rows)
    for row in rows:
        if row[0] == "all":
            print(f"minimum {row[1]}: {directions[0]} {row[2]}, {directions[1]} {row[3]}, cost {row[4]}")
    return OK


def _basin(options: Options) -> int:
    """Where single starts end: measured, written, drawn."""
    from dataclasses import replace

    from semloc_jax import viz
    from semloc_jax.alignment.one_start import WIDE_COST_MAPS
    from semloc_jax.analysis.basin import BasinConfig, BasinWindow, basin
    from semloc_jax.reports import results
    from semloc_jax.viz.basin import basin_on_map

    try:
        window = BasinWindow(*(float(value) for value in options.window.split(",")))
    except (TypeError, ValueError) as error:
        text = f"--window '{options.window}': expected three numbers such as 5,3,10 [m, m, deg]"
        raise UsageError(text) from error
    if options.starts < 1 or min(window.longitudinal_m, window.lateral_m, window.heading_deg) <= 0:
        raise UsageError("--starts, --window: expected at least one start and half widths above 0")
    inputs = open_inputs(options)
    frame = inputs.frame(options.frame)
    localize = replace(options.settings, cost_maps=WIDE_COST_MAPS)
    config = BasinConfig(num_starts=options.starts, seed=options.seed, localize=localize)
    (found,) = basin(inputs.drive, inputs.map, inputs.masks, (window,), (frame,), config)

    folder = results.make_folder(options.out)
    title = f"{inputs.drive.name} frame {frame.id}, masks {inputs.masks.name}: found from {100 * found.single:.0f} %"
    figure = basin_on_map(found, 0, inputs.map.elements, inputs.drive.truth_at(frame), title)
    print(f"picture: {viz.save(figure, folder / 'basin.png')}")
    columns = ("longitudinal_m", "lateral_m", "heading_deg")
    names = (*(f"start_{c}" for c in columns), *(f"end_{c}" for c in columns), "score", "success")
    parts = (*found.start_error[0].T, *found.end_error[0].T, found.score[0])
    rows = [(*(f"{v:.4f}" for v in row), int(ok)) for *row, ok in zip(*parts, found.success[0], strict=True)]
    results.write_csv(folder / "basin.csv", names, rows)
    shares = ", ".join(f"best of {n} {100 * found.best_of(n):.1f} %" for n in (8, 64) if n <= options.starts)
    print(f"starts within {window}: one finds the pose in {100 * found.single:.1f} %{', ' + shares if shares else ''}")
    if options.prove:
        _prove(inputs, frame, localize, folder)
    return OK


def _prove(inputs: Inputs, frame: "Frame", config: "LocalizeConfig", folder: Path) -> None:
    """Regions without a pose as good as the minimum on each level of the cost maps down to 20 px: said and written."""
    from semloc_jax.alignment.frame_localizer import FrameLocalizer
    from semloc_jax.analysis.certificate import CertificateConfig
    from semloc_jax.analysis.frame_certificate import certify_frame
    from semloc_jax.reports import results

    localizer = FrameLocalizer(inputs.map, inputs.masks.table, config)
    masks, rig = inputs.masks.masks(frame), inputs.masks.seen_by(frame.rig.select(inputs.masks.cameras))
    T_map_base, rows = inputs.drive.truth_at(frame), []
    for level, ramp_px in enumerate(config.cost_maps.ramp_px):
        if ramp_px < 20.0:
            break
        region = certify_frame(localizer, masks, rig, T_map_base, CertificateConfig(level), ("higher",)).higher
        if region is None:
            print(f"ramp of {ramp_px:g} px: nothing could be proven")
        else:
            print(f"ramp of {ramp_px:g} px: no pose as good as the minimum within {region}")
            rows.append((ramp_px, *(f"{value:.4f}" for value in (*region.outer, *region.inner))))
    columns = ("longitudinal_m", "lateral_m", "heading_deg")
    names = ("ramp_px", *(f"{box}_{c}" for box in ("outer", "inner") for c in columns))
    results.write_csv(folder / "proof.csv", names, rows)


def _search(options: Options) -> int:
    """The hypotheses of the search from the prior, stage by stage, around the true pose or else around the prior."""
    from semloc_jax import viz
    from semloc_jax.alignment.frame_localizer import FrameLocalizer
    from semloc_jax.analysis.search_trace import trace_search
    from semloc_jax.reports import results
    from semloc_jax.viz.search import search_stages

    inputs = open_inputs(options)
    frame = inputs.frame(options.frame)
    prior, settings = inputs.prior(frame), options.settings
    localizer = FrameLocalizer(inputs.map, inputs.masks.table, settings)
    rig = inputs.masks.seen_by(frame.rig.select(inputs.masks.cameras))
    stages = trace_search(localizer, inputs.masks.masks(frame), rig, prior)
    has_truth = inputs.drive.truth is not None
    T_map_middle = inputs.drive.truth_at(frame) if has_truth else prior.on_road(inputs.map)
    away_m = math.hypot(prior.x_m - T_map_middle[0, 3], prior.y_m - T_map_middle[1, 3])
    reach_m = away_m + settings.frame.reach * prior.sigma_xy_m
    figure = search_stages(inputs.map.elements, stages, T_map_middle, (reach_m, reach_m))
    folder = results.make_folder(options.out)
    print(f"picture: {viz.save(figure, folder / 'search.png')}")
    for name in stages:
        print(name)
    return OK


def _serve(options: Options) -> int:
    """The explorer, until it is interrupted."""
    import functools

    from semloc_jax.explorer import serve

    inputs = open_inputs(options)
    serve(
        inputs.drive,
        inputs.map,
        inputs.masks,
        inputs.prior,
        options.frame,
        options.settings,
        options.level,
        options.around,
        options.port,
        not options.no_browser,
        functools.partial(print, flush=True),
    )
    return OK


def _grid(options: Options) -> tuple[tuple[str, str], tuple[float, float], tuple[int, int]]:
    """The two directions, the half widths [m or deg] and the numbers of poses along them."""
    from semloc_jax.viz.landscape import DIRECTIONS

    directions = parse_names(options.over) or ()
    if len(set(directions)) != 2 or not set(directions) <= set(DIRECTIONS):
        raise UsageError(f"--over '{options.over}': expected two different ones of {', '.join(DIRECTIONS)}, e.g. x,yaw")
    try:
        extents = tuple(float(value) for value in options.extent.split(","))
        steps = tuple(int(value) for value in options.steps.split(","))
    except ValueError as error:
        raise UsageError(f"--extent or --steps: {error}; expected two numbers such as 4,2") from error
    if len(extents) != 2 or len(steps) != 2 or min(extents) <= 0 or min(steps) < 3:
        raise UsageError("--extent, --steps: expected two positive extents and two counts of at least 3")
    return directions, extents, steps
