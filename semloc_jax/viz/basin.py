"""Which starts find the pose, drawn where they stood (room: viz).

In: basins. Out: Figures: starts by place and by heading, success by their number; the starts of one frame on the map.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from semloc_jax.analysis.basin import Basin
from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import MapElement
from semloc_jax.viz.bev import draw_map, draw_vehicle
from semloc_jax.viz.style import INK, LIGHT, REFERENCE, new_figure, plain_axes

FOUND, LOST = "#1565c0", "#ff6d00"
_SHADES = ("#0d47a1", "#00897b", "#8e24aa", "#6d4c41")


def basin_view(basins: Sequence[Basin]) -> Figure:
    """One column for each window: its starts by place and by heading, blue where the pose was found, else orange.

    The panel on the right shows how often the best scored of several starts finds the pose.

    Args:
        basins: From `analysis.basin.basin`.

    Raises:
        SemlocError: no basins.
    """
    if not basins:
        raise SemlocError("basin view: no basins to draw; expected at least one window")
    figure = new_figure(3.3 * len(basins) + 3.7, 5.6)
    grid = figure.add_gridspec(2, len(basins) + 1, width_ratios=[1.0] * len(basins) + [1.1])
    for column, basin in enumerate(basins):
        start, found = basin.start_error.reshape(-1, 3), basin.success.reshape(-1)
        above, below = (plain_axes(figure.add_subplot(grid[row, column])) for row in range(2))
        _draw_starts(above, start[:, 1], start[:, 0], found)
        _draw_starts(below, start[:, 1], start[:, 2], found)
        above.set_title(f"{basin.window}\none start: {100 * basin.single:.1f} %", fontsize=9, color=INK)
        below.set_xlabel("lateral start error [m]", fontsize=9)
        if column == 0:
            above.set_ylabel("longitudinal [m]", fontsize=9)
            below.set_ylabel("heading [deg]", fontsize=9)
            above.legend(loc="upper left", fontsize=7, framealpha=0.9, handletextpad=0.1, borderpad=0.3)
    _draw_curves(plain_axes(figure.add_subplot(grid[:, len(basins)])), basins)
    return figure


def _draw_starts(axes: Axes, x: np.ndarray, y: np.ndarray, found: np.ndarray) -> None:
    size = float(np.clip(2000.0 / len(x), 4.0, 14.0))
    axes.scatter(x[found], y[found], s=size, color=FOUND, alpha=0.55, linewidths=0, label="found")
    axes.scatter(x[~found], y[~found], s=size, color=LOST, linewidths=0, zorder=3, label="lost")


def _draw_curves(axes: Axes, basins: Sequence[Basin]) -> None:
    for basin, colour in zip(basins, _SHADES, strict=False):
        total = basin.success.shape[1]
        counts = np.unique(np.geomspace(1, total, 24).astype(int))
        share = [100 * basin.best_of(int(count)) for count in counts]
        axes.plot(counts, share, "o-", color=colour, markersize=3, linewidth=1.4, label=str(basin.window))
    axes.set_xscale("log", base=2)
    ticks = 2 ** np.arange(int(np.log2(max(b.success.shape[1] for b in basins))) + 1)
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.set_ylim(top=101.5)
    axes.set_xlabel("starts, the best scored counts", fontsize=9)
    axes.set_title("pose found [%]", fontsize=9, color=INK)
    axes.legend(loc="lower right", fontsize=7, frameon=False)


def basin_on_map(
    basin: Basin, frame: int, elements: Sequence[MapElement], T_true: np.ndarray, title: str = ""
) -> Figure:
    """The starts of one frame on the map, by how far from the truth each ended, and success against each offset.

    Args:
        basin: Of one window.
        frame: Which of its frames.
        elements: Of the map.
        T_true: True pose T_map_base of the frame.
        title: Text above the map.
    """
    start, end, found = basin.start_error[frame], basin.end_error[frame], basin.success[frame]
    figure = new_figure(12.0, 6.2, dark=True)
    grid = figure.add_gridspec(3, 2, width_ratios=[1.25, 1.0])
    axes = plain_axes(figure.add_subplot(grid[:, 0]), dark=True)
    draw_map(axes, elements, 0.6)
    draw_vehicle(axes, T_true, REFERENCE, fill=False)
    ends_m = np.maximum(np.hypot(end[:, 0], end[:, 1]), 0.01)
    points = _draw_on_map(axes, start, ends_m, T_true)
    reach_m = 1.2 * np.hypot(basin.window.longitudinal_m, basin.window.lateral_m)
    axes.set_xlim(T_true[0, 3] - reach_m, T_true[0, 3] + reach_m)
    axes.set_ylim(T_true[1, 3] - reach_m, T_true[1, 3] + reach_m)
    axes.set_aspect("equal")
    axes.set_title(title, fontsize=9, color=LIGHT)
    axes.set_xlabel("x east [m]", fontsize=9, color=LIGHT)
    axes.set_ylabel("y north [m]", fontsize=9, color=LIGHT)
    bar = figure.colorbar(points, ax=axes, pad=0.02, shrink=0.8)
    bar.set_label("start, coloured by how far from the truth it ended [m]", fontsize=8, color=LIGHT)
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.ax.tick_params(labelsize=8, colors=LIGHT, which="both")
    bar.outline.set_visible(False)
    for row, name in enumerate(("longitudinal offset of the start [m]", "lateral offset [m]", "heading offset [deg]")):
        _draw_success(plain_axes(figure.add_subplot(grid[row, 1]), dark=True), start[:, row], found, name)
    return figure


def _draw_on_map(axes: Axes, start: np.ndarray, ends_m: np.ndarray, T_true: np.ndarray) -> PathCollection:
    """A dot with a tick along its heading for each start."""
    forward, left = T_true[:2, 0], T_true[:2, 1]
    xy = T_true[:2, 3] + start[:, :1] * forward + start[:, 1:2] * left
    heading = np.arctan2(forward[1], forward[0]) + np.deg2rad(start[:, 2])
    norm = LogNorm(0.01, 10.0)
    colours = colormaps["RdYlBu_r"](norm(ends_m))
    ticks = np.stack([xy, xy + 0.45 * np.column_stack([np.cos(heading), np.sin(heading)])], axis=1)
    axes.add_collection(LineCollection(ticks, colors=colours, linewidths=1.0, zorder=6))
    return axes.scatter(*xy.T, c=ends_m, cmap="RdYlBu_r", norm=norm, s=16, linewidths=0, zorder=7)


def _draw_success(axes: Axes, offset: np.ndarray, found: np.ndarray, name: str) -> None:
    """Share of the starts that found the pose, by one of their three offsets."""
    edges = np.linspace(-np.abs(offset).max(), np.abs(offset).max() + 1e-9, 12)
    index = np.digitize(offset, edges) - 1
    share = np.array([100 * found[index == k].mean() if (index == k).any() else np.nan for k in range(11)])
    colours = colormaps["RdYlBu"](np.nan_to_num(share) / 100.0)
    axes.bar(0.5 * (edges[1:] + edges[:-1]), share, 0.92 * np.diff(edges), color=colours)
    axes.set_ylim(0, 105)
    axes.set_xlabel(name, fontsize=9, color=LIGHT)
    axes.set_ylabel("found [%]", fontsize=9, color=LIGHT)
