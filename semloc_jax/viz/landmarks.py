"""How the error falls with the number of landmarks, beside the least possible one (room: viz).

In: rows of `reports.landmarks` as plain data. Out: a Figure.
"""

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from semloc_jax.viz.style import INK, PRIOR, REFERENCE, new_figure, plain_axes

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
