"""How errors fall with numbers: of drives of a crowd map, of landmarks, beside the least possible error (room: viz).

In: rows of numbers and errors. Out: a Figure.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from semloc_jax.viz.style import INK, PRIOR, REFERENCE, new_figure, plain_axes

_BIAS_M = 1.0
"""Error of the satellite fixes that a drive shares, one standard deviation of each direction."""
_STEPS_M = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


def error_against_drives(rows: Sequence[tuple[int, int, float, float, float]]) -> Figure:
    """Absolute and relative errors against the number of drives, with what nothing can beat.

    Args:
        rows: number of drives, number of maps, absolute error, error across and along after one motion [m].
    """
    figure = new_figure(7.5, 4.6)
    axes = plain_axes(figure.add_subplot())
    table = np.array(rows, dtype=np.float64)
    num = table[:, 0]
    bound = np.sqrt(2.0) * _BIAS_M / np.sqrt(num)
    axes.plot(num, bound, "--", color=REFERENCE, label=f"bound: {_BIAS_M:g} m of bias each way, by the root of N")
    for column, colour, mark, name in (
        (2, "#1f6fd0", "o", "as it lies"),
        (4, PRIOR, "s", "dashes along, after one motion"),
        (3, "#7b61c9", "^", "dashes and lines across, after one motion"),
    ):
        axes.plot(num, table[:, column], f"{mark}-", color=colour, label=name, markersize=5)
    axes.set(xscale="log", yscale="log", xlabel="drives", ylabel="root mean square error [m]")
    axes.set_xticks(num, [f"{int(n)}" for n in num])
    low_m, high_m = axes.get_ylim()
    steps = [step for step in _STEPS_M if low_m <= step <= high_m]
    axes.set_yticks(steps, [f"{step:g}" for step in steps])
    axes.minorticks_off()
    axes.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return figure


_WINDOW = "#1f6fd0"


def landmark_figure(by_number: Sequence[dict[str, Any]], by_road: Sequence[dict[str, Any]]) -> Figure:
    """Errors against signs and posts in view: of all frames by their number, and of each road.

    Args:
        by_number: Rows of frames with like numbers in view.
        by_road: Rows of roads.
    """
    figure = new_figure(11.0, 4.4)
    left, right = figure.subplots(1, 2, sharey=True)
    _curves(plain_axes(left), by_number, "signs and posts in view of a frame")
    _curves(plain_axes(right), by_road, "signs and posts in view, mean of a road")
    for row in by_road:
        place = row["in_view"], row["window_m"]
        right.annotate(row["group"], place, (0, -14), textcoords="offset points", fontsize=7.5, color=INK, ha="center")
    left.set_ylabel("root mean square error in the plane [m]")
    left.legend(fontsize=8, frameon=False)
    return figure


def _curves(axes: Axes, rows: Sequence[dict[str, Any]], name: str) -> None:
    x = [row["in_view"] for row in rows]
    for key, colour, text in (("alone", PRIOR, "one frame"), ("window", _WINDOW, "twelve frames with motion")):
        axes.plot(x, [row[f"{key}_m"] for row in rows], "o-", color=colour, label=text, markersize=5)
        axes.plot(x, [row[f"{key}_bound_m"] for row in rows], "--", color=colour, label="its bound (Cramer, Rao)")
    axes.axhline(0.1, color=REFERENCE, lw=0.8)
    axes.set(xscale="log", yscale="log", xlabel=name)
    axes.set_xticks([1, 2, 4, 8, 16, 32], ["1", "2", "4", "8", "16", "32"])
    axes.set_yticks([0.03, 0.1, 0.3, 1.0], ["0.03", "0.1", "0.3", "1"])
    axes.minorticks_off()
