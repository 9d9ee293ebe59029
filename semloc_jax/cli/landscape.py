"""`semloc landscape`: the cost around the pose of one frame, over two of the six directions (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from semloc_jax.cli.drive_options import DriveOptions
from semloc_jax.cli.main import OK
from semloc_jax.errors import UsageError
from semloc_jax.inputs.choices import parse_names
from semloc_jax.inputs.drive_inputs import open_inputs

if TYPE_CHECKING:
    from semloc_jax.alignment.frame_localizer import LocalizeConfig
    from semloc_jax.analysis.basin import BasinWindow
    from semloc_jax.reports.landscape import Grid


@dataclass(frozen=True)
class Options(DriveOptions):
    """The cost around the pose of one frame, over two of the six directions, for all classes and for each alone.

    Shows what holds the pose and what does not: a valley is a direction that the class says nothing about, a second
    basin is a pose that it would confuse with the true one. Writes landscape.png and minima.csv.
    With --basin it measures from how far away the true pose is found and writes basin.png and basin.csv instead.
    With --stages it draws instead which hypotheses each stage of the search from the prior leaves: search.png.
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
    stages: bool = False
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
    """Write the landscape or the basin; or serve the explorer."""
    if options.serve:
        return _serve(options)
    from semloc_jax.reports.landscape import report_basin, report_landscape, report_search

    if options.basin:
        window = _window(options)
        inputs = open_inputs(options)
        sampling = (options.starts, options.seed, options.prove)
        report = report_basin(inputs, options.frame, window, options.settings, *sampling, options.out)
    elif options.stages:
        report = report_search(open_inputs(options), options.frame, options.settings, options.out)
    else:
        grid = _grid(options)
        inputs = open_inputs(options)
        where = (options.level, options.around == "truth")
        report = report_landscape(inputs, options.frame, grid, options.settings, *where, options.out)
    print(report.text)
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


def _window(options: Options) -> "BasinWindow":
    """The half widths that starts are drawn from."""
    from semloc_jax.analysis.basin import BasinWindow

    try:
        window = BasinWindow(*(float(value) for value in options.window.split(",")))
    except (TypeError, ValueError) as error:
        text = f"--window '{options.window}': expected three numbers such as 5,3,10 [m, m, deg]"
        raise UsageError(text) from error
    if options.starts < 1 or min(window.longitudinal_m, window.lateral_m, window.heading_deg) <= 0:
        raise UsageError("--starts, --window: expected at least one start and half widths above 0")
    return window


def _grid(options: Options) -> "Grid":
    """The two directions, the half widths [m or deg] and the numbers of poses along them."""
    from semloc_jax.reports.landscape import Grid
    from semloc_jax.viz.cost_slices import DIRECTIONS

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
    return Grid(directions, extents, steps)
