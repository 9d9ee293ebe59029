"""The Stanford diagram: error against protection level, with the alert limit (room: viz).

In: errors, protection levels and limits by direction. Out: a Figure.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from semloc_jax.evaluation.integrity import stanford_counts
from semloc_jax.viz.style import INK, new_figure, plain_axes

_FINE, _SAFE, _WRONG, _HAZARD = "#2e7d32", "#90a4ae", "#ff8f00", "#d50000"


class IntegrityErrors(NamedTuple):
    """Errors, protection levels and the alert limit of one direction, in one unit."""

    error: Float[np.ndarray, " n"]
    level: Float[np.ndarray, " n"]
    limit: float
    unit: str


def stanford_diagram(directions: Mapping[str, IntegrityErrors]) -> Figure:
    """A Stanford diagram for each direction, side by side.

    Points above the diagonal are frames whose protection level bounds the error; left of the vertical alert limit the
    frame was usable; the field below the limit in level and beyond it in error is hazardous.

    Args:
        directions: By name.
    """
    figure = new_figure(3.6 * len(directions), 3.9)
    axes = np.atleast_1d(figure.subplots(1, len(directions)))
    for place, (name, direction) in zip(axes, directions.items(), strict=True):
        _draw(plain_axes(place), name, direction)
    return figure


def _draw(axes: Axes, name: str, direction: IntegrityErrors) -> None:
    limit, unit = direction.limit, direction.unit
    size = np.abs(direction.error)
    known = np.isfinite(size) & ~np.isnan(direction.level)
    size, level = size[known], direction.level[known]
    counts = stanford_counts(size, level, limit)
    largest = 1.6 * limit
    top = np.minimum(level, 0.985 * largest)
    axes.fill_between([0, limit], [0, limit], [limit, limit], color=_FINE, alpha=0.07, linewidth=0)
    axes.fill_between([limit, largest], 0, limit, color=_HAZARD, alpha=0.10, linewidth=0)
    axes.plot([0, largest], [0, largest], color=INK, linewidth=0.8)
    axes.axhline(limit, color=_HAZARD, linewidth=0.9, linestyle=(0, (5, 3)))
    axes.axvline(limit, color=_HAZARD, linewidth=0.9, linestyle=(0, (5, 3)))
    hazard = (level <= limit) & (size > limit)
    colour = np.where(hazard, _HAZARD, np.where(size > level, _WRONG, np.where(level <= limit, _FINE, _SAFE)))
    axes.scatter(np.minimum(size, 0.985 * largest), top, s=9, c=colour, linewidths=0, alpha=0.8, clip_on=False)
    axes.set_xlim(0, largest)
    axes.set_ylim(0, largest)
    axes.set_aspect("equal")
    axes.set_xlabel(f"{name} error [{unit}]")
    axes.set_ylabel(f"protection level [{unit}]")
    num = max(counts.num_frames, 1)
    axes.set_title(
        f"available {counts.available / num:.1%}, misleading {counts.misleading / num:.1%}, "
        f"hazardous {counts.hazardous}",
        fontsize=8,
        color=INK,
    )
    said = f"alert limit {limit:g} {unit}"
    axes.text(0.98 * largest, 1.02 * limit, said, fontsize=7, color=_HAZARD, va="bottom", ha="right")
