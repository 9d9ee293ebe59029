"""What calibrations leave: of a drive, before and after; of targets, residuals and surveyed corners (room: viz).

In: Observability, lines with both calibrations; fits of lenses and mounts. Out: Figures.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Wedge
from matplotlib.ticker import NullFormatter

from semloc_jax.calibration import Knowledge, Observability, Parameter
from semloc_jax.calibration.lens_on_boards import LensFit
from semloc_jax.calibration.mounts_on_mats import MountFit
from semloc_jax.calibration.road_calibration import RoadCalibration
from semloc_jax.viz.bev import VEHICLE_M
from semloc_jax.viz.style import INK, new_figure, plain_axes

_COLOURS = {Knowledge.OBSERVABLE: "#00897b", Knowledge.WEAK: "#f9a825", Knowledge.HELD: "#c62828"}
_CAMERAS = ("#1565c0", "#c62828", "#2e7d32", "#f9a825", "#6a1b9a", "#00838f")
_PRIOR = "#b0bec5"
_FEW = 4


def observability_figure(observability: Observability) -> Figure:
    """Sigma of every parameter before (grey) and after the drive (coloured by verdict), one panel for each unit.

    Units of few parameters share a column.
    """
    units = dict.fromkeys(p.unit for p in observability.parameters)
    panels = [[p for p in observability.parameters if p.unit == unit] for unit in units]
    tall, short = [p for p in panels if len(p) > _FEW], [p for p in panels if len(p) <= _FEW]
    columns = len(tall) + bool(short)
    height = 1.2 + max([0.27 * len(panel) for panel in tall] + [sum(0.7 + 0.27 * len(panel) for panel in short)])
    figure = new_figure(1.0 + 3.6 * columns, height)
    grid = figure.add_gridspec(max(len(short), 1), columns, height_ratios=[len(p) + 1 for p in short] or None)
    places = [grid[:, k] for k in range(len(tall))] + [grid[k, columns - 1] for k in range(len(short))]
    for place, panel in zip(places, tall + short, strict=True):
        _column(plain_axes(figure.add_subplot(place)), panel)
    handles = [Line2D([], [], marker="o", linestyle="", color=_PRIOR, label="before")]
    handles += [Line2D([], [], marker="o", linestyle="", color=c, label=str(v)) for v, c in _COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=9, frameon=False, labelcolor=INK)
    return figure


def seen_lines_figure(result: RoadCalibration) -> Figure:
    """Painted lines as every camera sees them, with the calibration as given and as found; one colour a camera."""
    parts = ("before", result.seen.before, result.before_m), ("after", result.seen.after, result.after_m)
    wide_m, high_m = np.ptp(np.concatenate([xy for _, xy, _ in parts]), axis=0)
    rows, columns = (2, 1) if wide_m > high_m else (1, 2)
    figure = new_figure(9.0, 0.8 + rows * float(np.clip(8.0 / columns * high_m / wide_m, 2.0, 8.0)))
    first = None
    for k, (title, xy, off_m) in enumerate(parts):
        axes = plain_axes(figure.add_subplot(rows, columns, k + 1, sharex=first, sharey=first))
        first = axes
        for camera, name in enumerate(result.rig.names):
            own = xy[result.seen.camera == camera]
            axes.plot(own[:, 0], own[:, 1], ".", color=_CAMERAS[camera % len(_CAMERAS)], markersize=2, label=name)
        axes.plot(result.T_odom_base[:, 0, 3], result.T_odom_base[:, 1, 3], color=INK, linewidth=1.0, label="vehicle")
        axes.set_aspect("equal")
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.set_title(f"{title}: {100 * off_m:.1f} cm from the line, root mean square", fontsize=9, loc="left")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=7, fontsize=9, frameon=False, labelcolor=INK, markerscale=4
    )
    return figure


def _column(axes, parameters: Sequence[Parameter]) -> None:
    for row, p in enumerate(parameters):
        axes.plot([p.sigma, p.prior_sigma], [row, row], color=_PRIOR, linewidth=1.2, zorder=1)
        axes.plot(p.prior_sigma, row, "o", color=_PRIOR, markersize=5)
        axes.plot(p.sigma, row, "o", color=_COLOURS[p.verdict], markersize=6)
    axes.set_xscale("log")
    axes.xaxis.set_minor_formatter(NullFormatter())  # on little more than a decade they would run into each other
    high = max(p.prior_sigma for p in parameters)
    low = min(0.1 * high, *(p.sigma for p in parameters))
    axes.set_xlim(0.5 * low, 2.0 * high)
    axes.set_yticks(range(len(parameters)), [p.name.replace("_", " ") for p in parameters])
    axes.set_ylim(len(parameters) - 0.5, -0.5)
    axes.set_xlabel(f"sigma [{parameters[0].unit}]" if parameters[0].unit else "sigma")


_MAGNIFIED = 100.0
_HUES = ("#0d47a1", "#c62828", "#2e7d32", "#f57f17", "#6a1b9a", "#00838f")


def target_figure(names: tuple[str, ...], lenses: list[LensFit], mounts: MountFit | None) -> Figure:
    """For each camera the corners of all boards with their residuals, 100 times as long, and the parts of the picture
    that no board covers in red; below, surveyed corners of mats from above with their errors, 10 times as long."""
    figure = new_figure(4.2 * len(names), 3.7 if mounts is None else 9.2)
    rows = figure.subfigures(2, 1, height_ratios=(3.5, 5.5)) if mounts is not None else [figure]
    for axes, name, fit in zip(np.atleast_1d(rows[0].subplots(1, len(names))), names, lenses, strict=True):
        _draw_lens(axes, name, fit)
    if mounts is not None:
        _draw_mats(rows[1].subplots(), names, mounts)
    return figure


def _draw_lens(axes, name: str, fit: LensFit) -> None:
    width, height = fit.camera.resolution
    centre, ring_px = (float(fit.camera.cx), float(fit.camera.cy)), 0.5 * 0.9 * width / len(fit.covered)
    for ring, sectors in enumerate(fit.covered):
        for sector, covered in enumerate(sectors):
            if not covered:
                turn = 360.0 / len(sectors)
                part = Wedge(centre, (ring + 1) * ring_px, sector * turn, (sector + 1) * turn, width=ring_px)
                part.set(facecolor="#c62828", alpha=0.18, linewidth=0)
                axes.add_patch(part)
    axes.add_patch(Circle(centre, len(fit.covered) * ring_px, fill=False, edgecolor="#90a4ae", linewidth=0.6))
    uv, off = np.concatenate(fit.corners_px), np.concatenate(fit.residuals_px)
    axes.quiver(*uv.T, *(_MAGNIFIED * off.T), angles="xy", scale_units="xy", scale=1, width=0.003, color="#0d47a1")
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xticks=(), yticks=())
    axes.set_title(
        f"{name}: rms {fit.rms_px:.2f} px, {len(fit.used)} views to {fit.widest_deg:.0f} deg", fontsize=9, loc="left"
    )


def _draw_mats(axes, names: tuple[str, ...], fit: MountFit) -> None:
    plain_axes(axes)
    axes.fill(VEHICLE_M[:, 1], VEHICLE_M[:, 0], facecolor="#eceff1", edgecolor="#90a4ae")
    for index, name in enumerate(names):
        at = fit.camera == index
        size = 400.0 * fit.after_m[at]
        axes.scatter(
            fit.p_base[at, 1], fit.p_base[at, 0], s=10 + 20 * size, facecolor="none", edgecolor=_HUES[index % 6],
            linewidth=0.9, label=f"{name}: {1e3 * fit.after_m[at].mean():.1f} mm",
        )  # fmt: skip
    axes.invert_xaxis()
    axes.set_aspect("equal")
    axes.set_xlabel("y [m], left is left", fontsize=9)
    axes.set_ylabel("x [m], ahead is up", fontsize=9)
    axes.set_title("surveyed corners: the area of a circle grows with its error", fontsize=9, loc="left")
    for handle in axes.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.02, 0.5)).legend_handles:
        handle.set_sizes([40.0])
