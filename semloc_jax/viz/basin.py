"""Which starts find the pose, drawn where they stood (room: viz).

In: basins. Out: a Figure: starts by place and by heading, and success by their number.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from semloc_jax.errors import SemlocError
from semloc_jax.localization.basin import Basin
from semloc_jax.viz.style import INK, new_figure, plain_axes

FOUND, LOST = "#1565c0", "#ff6d00"
_SHADES = ("#0d47a1", "#00897b", "#8e24aa", "#6d4c41")


def basin_view(basins: Sequence[Basin]) -> Figure:
    """One column for each window: its starts by place and by heading, blue where the pose was found, else orange.

    The panel on the right shows how often the best scored of several starts finds the pose.

    Args:
        basins: From `localization.basin.basin`.

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
