"""How the error of a crowd map falls with the number of its drives (room: viz).

In: rows of numbers of drives and errors. Out: a Figure.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from semloc_jax.viz.style import PRIOR, REFERENCE, new_figure, plain_axes

_STEPS_M = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


def error_against_drives(rows: Sequence[tuple[int, int, float, float, float]], bias_m: float = 1.0) -> Figure:
    """Absolute and relative errors against the number of drives, with what nothing can beat.

    Args:
        rows: number of drives, number of maps, absolute error, error across and along after one motion [m].
        bias_m: error of the satellite fixes that a drive shares, one standard deviation of each direction.
    """
    figure = new_figure(7.5, 4.6)
    axes = plain_axes(figure.add_subplot())
    table = np.array(rows, dtype=np.float64)
    num = table[:, 0]
    bound = np.sqrt(2.0) * bias_m / np.sqrt(num)
    axes.plot(num, bound, "--", color=REFERENCE, label=f"bound: {bias_m:g} m of bias each way, by the root of N")
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
