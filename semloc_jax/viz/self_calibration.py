"""What a drive knows of a calibration, before and after (room: viz).

In: Observability; lines with both calibrations. Out: Figures.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from semloc_jax.calibration import Knowledge, Observability, Parameter
from semloc_jax.calibration.road_calibration import RoadCalibration
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
