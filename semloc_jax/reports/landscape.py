"""The report of the cost around one pose: what `semloc landscape` writes (room: reports; host).

In: opened inputs, a frame, two directions or a window. Out: landscape.png, minima.csv; basin.png, basin.csv, proof.csv.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from semloc_jax import viz
from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.alignment.one_start import WIDE_COST_MAPS
from semloc_jax.analysis.basin import Basin, BasinConfig, BasinWindow, basins_of
from semloc_jax.analysis.certificate import CertificateConfig
from semloc_jax.analysis.frame_certificate import certify_frame
from semloc_jax.analysis.landscape import trace_search
from semloc_jax.datasets import Frame
from semloc_jax.inputs.drive_inputs import Inputs
from semloc_jax.reports.folder import make_folder
from semloc_jax.reports.tables import write_csv
from semloc_jax.viz.basin import basin_on_map
from semloc_jax.viz.cost_slices import slices_of_frame
from semloc_jax.viz.search import search_stages

_ERRORS = ("longitudinal_m", "lateral_m", "heading_deg")
_FINEST_PROVEN_PX = 20.0
"""On narrower ramps the bounds prove nothing."""


class Grid(NamedTuple):
    """Two of x, y, z, roll, pitch, yaw, the half width along each [m or deg], and the number of poses along each."""

    directions: tuple[str, str]
    extents: tuple[float, float]
    steps: tuple[int, int]


class LandscapeReport(NamedTuple):
    """Where a landscape was written, and what it says to people."""

    folder: Path
    text: str


def report_landscape(
    inputs: Inputs,
    index: int,
    grid: Grid,
    settings: LocalizeConfig | None = None,
    level: int = 1,
    is_around_truth: bool = True,
    out: Path | None = None,
) -> LandscapeReport:
    """The cost of one frame over two directions, of all classes and of each alone, drawn and with its minima listed.

    Args:
        inputs: Drive, map, masks and prior.
        index: Of the frame.
        grid: What is varied.
        settings: Of cost maps and views; None for the defaults.
        level: Of the cost maps; 0 is the coarsest.
        is_around_truth: The true pose in the middle, where the drive has one; else the prior.
    """
    settings = settings or LocalizeConfig()
    frame = inputs.frame(index)
    is_truth = is_around_truth and inputs.drive.truth is not None
    T_map_base = inputs.drive.truth_at(frame) if is_truth else inputs.prior(frame).on_road(inputs.map)
    localizer = FrameLocalizer(inputs.map, inputs.masks.table, settings)
    given = (*_seen(inputs, frame), T_map_base, grid.directions, grid.extents, level, grid.steps)
    slices = slices_of_frame(localizer, *given)
    folder = make_folder(out)
    ramp_px = settings.cost_maps.ramp_px[level]
    title = f"{inputs.drive.name} frame {frame.id}, masks {inputs.masks.name}, ramp {ramp_px:g} px"
    picture = viz.save(viz.landscape(slices, title, (0.0, 0.0) if is_truth else None), folder / "landscape.png")
    rows = [
        (name, rank, f"{m.offset_a:.4f}", f"{m.offset_b:.4f}", f"{m.cost:.4f}")
        for name, piece in slices.items()
        for rank, m in enumerate(viz.find_minima(piece), start=1)
    ]
    write_csv(folder / "minima.csv", ("class", "rank", *grid.directions, "cost"), rows)
    a, b = grid.directions
    minima = [f"minimum {row[1]}: {a} {row[2]}, {b} {row[3]}, cost {row[4]}" for row in rows if row[0] == "all"]
    return LandscapeReport(folder, "\n".join([f"picture: {picture}", *minima]))


def report_basin(
    inputs: Inputs,
    index: int,
    window: BasinWindow,
    settings: LocalizeConfig | None = None,
    num_starts: int = 512,
    seed: int = 0,
    is_proven: bool = False,
    out: Path | None = None,
) -> LandscapeReport:
    """From where around the true pose of one frame a single start finds it: measured, written, drawn.

    Args:
        inputs: Drive with truth, map, masks and prior.
        index: Of the frame.
        window: Half widths that the starts are drawn from.
        settings: None for the defaults; the cost maps are the wide ones.
        num_starts: Number of starts.
        seed: Of their places.
        is_proven: Whether regions without another pose are proven, too.
    """
    frame = inputs.frame(index)
    localize = replace(settings or LocalizeConfig(), cost_maps=WIDE_COST_MAPS)
    config = BasinConfig(num_starts=num_starts, seed=seed, localize=localize)
    (found,) = basins_of(inputs.drive, inputs.map, inputs.masks, (window,), (frame,), config)
    folder = make_folder(out)
    title = f"{inputs.drive.name} frame {frame.id}, masks {inputs.masks.name}: found from {100 * found.single:.0f} %"
    figure = basin_on_map(found, 0, inputs.map.elements, inputs.drive.truth_at(frame), title)
    picture = viz.save(figure, folder / "basin.png")
    _write_basin(found, folder)
    shares = "".join(f", best of {n} {100 * found.best_of(n):.1f} %" for n in (8, 64) if n <= num_starts)
    lines = [f"picture: {picture}", f"starts within {window}: one finds the pose in {100 * found.single:.1f} %{shares}"]
    lines += _prove(inputs, frame, localize, folder) if is_proven else []
    return LandscapeReport(folder, "\n".join(lines))


def report_search(
    inputs: Inputs, index: int, settings: LocalizeConfig | None = None, out: Path | None = None
) -> LandscapeReport:
    """Draw the hypotheses that each stage of the search from the prior leaves, around the true pose or else the prior.

    Args:
        inputs: Drive, map, masks and prior.
        index: Of the frame.
        settings: Of the search; None for the defaults.
    """
    settings = settings or LocalizeConfig()
    frame = inputs.frame(index)
    prior = inputs.prior(frame)
    localizer = FrameLocalizer(inputs.map, inputs.masks.table, settings)
    stages = trace_search(localizer, *_seen(inputs, frame), prior)
    has_truth = inputs.drive.truth is not None
    T_map_middle = inputs.drive.truth_at(frame) if has_truth else prior.on_road(inputs.map)
    away_m = math.hypot(prior.x_m - T_map_middle[0, 3], prior.y_m - T_map_middle[1, 3])
    reach_m = away_m + settings.frame.reach * prior.sigma_xy_m
    figure = search_stages(inputs.map.elements, stages, T_map_middle, (reach_m, reach_m))
    folder = make_folder(out)
    return LandscapeReport(folder, "\n".join([f"picture: {viz.save(figure, folder / 'search.png')}", *stages]))


def _write_basin(found: Basin, folder: Path) -> None:
    names = (*(f"start_{c}" for c in _ERRORS), *(f"end_{c}" for c in _ERRORS), "score", "success")
    parts = (*found.start_error[0].T, *found.end_error[0].T, found.score[0])
    rows = [(*(f"{v:.4f}" for v in row), int(ok)) for *row, ok in zip(*parts, found.success[0], strict=True)]
    write_csv(folder / "basin.csv", names, rows)


def _seen(inputs: Inputs, frame: Frame) -> Sequence:
    """The masks of a frame and the rig that sees them."""
    return inputs.masks.masks(frame), inputs.masks.seen_by(frame.rig.select(inputs.masks.cameras))


def _prove(inputs: Inputs, frame: Frame, config: LocalizeConfig, folder: Path) -> list[str]:
    """Regions without a pose as good as the minimum, on each level of the cost maps down to 20 px."""
    localizer = FrameLocalizer(inputs.map, inputs.masks.table, config)
    given = (*_seen(inputs, frame), inputs.drive.truth_at(frame))
    rows, lines = [], []
    for level, ramp_px in enumerate(config.cost_maps.ramp_px):
        if ramp_px < _FINEST_PROVEN_PX:
            break
        region = certify_frame(localizer, *given, CertificateConfig(level), ("higher",)).higher
        if region is None:
            lines.append(f"ramp of {ramp_px:g} px: nothing could be proven")
        else:
            lines.append(f"ramp of {ramp_px:g} px: no pose as good as the minimum within {region}")
            rows.append((ramp_px, *(f"{value:.4f}" for value in (*region.outer, *region.inner))))
    names = ("ramp_px", *(f"{box}_{c}" for box in ("outer", "inner") for c in _ERRORS))
    write_csv(folder / "proof.csv", names, rows)
    return lines
