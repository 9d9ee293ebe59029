"""A map of points from above, as the literature makes it (room: viz).

In: points with a class each, poses, loops. Out: a Figure, x east and y north, in metres.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from semloc_jax.structs import ElementClass
from semloc_jax.viz.style import COLOURS, ESTIMATE, PRIOR, class_name, new_figure, plain_axes

_SIDE_IN = 9.0


def points_from_above(
    xy: Float[np.ndarray, "n 2"],
    label: Int[np.ndarray, " n"],
    Ts_map_base: Float[np.ndarray, "k 4 4"],
    loops: Sequence[tuple[np.ndarray, np.ndarray]] = (),
    title: str = "",
) -> Figure:
    """The points coloured by class, the way in white, and a line in amber between the ends of each loop.

    Args:
        xy: points [m].
        label: `ElementClass` of each.
        Ts_map_base: poses of the drive.
        loops: T_map_base of both ends of each loop that was accepted.
        title: text above the picture.
    """
    figure = new_figure(_SIDE_IN, _SIDE_IN, dark=True)
    axes = plain_axes(figure.add_subplot(), dark=True)
    handles = []
    for number in np.unique(label):
        own, colour = label == number, COLOURS[ElementClass(int(number))]
        axes.plot(*xy[own].T, ",", color=colour, alpha=0.6)
        handles.append(Line2D([], [], marker="s", linestyle="", color=colour, label=class_name(int(number))))
    axes.plot(Ts_map_base[:, 0, 3], Ts_map_base[:, 1, 3], color=ESTIMATE, linewidth=0.8, alpha=0.7)
    segments = [np.array([a[:2, 3], b[:2, 3]]) for a, b in loops]
    axes.add_collection(LineCollection(segments, colors=PRIOR, linewidths=1.6))
    axes.legend(handles=handles, fontsize=8, frameon=False, labelcolor="#e8edf4")
    axes.set(aspect="equal", xlabel="x east [m]", ylabel="y north [m]")
    axes.set_title(title, fontsize=10, loc="left", color="#e8edf4")
    return figure
