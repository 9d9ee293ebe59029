"""Hypotheses of a search converging, stage by stage, on the map (room: viz).

In: map elements, poses and scores of each stage. Out: a Figure with one panel for each stage.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import MapElement
from semloc_jax.viz.bev import draw_map
from semloc_jax.viz.style import REFERENCE, new_figure, plain_axes

_SHADES = colormaps["plasma"]
_TICK_M = 1.2
"""Length of the line that shows the heading of a hypothesis."""


def search_stages(
    elements: Sequence[MapElement],
    stages: Mapping[str, tuple[np.ndarray, np.ndarray]],
    reference: np.ndarray,
    reach_m: tuple[float, float],
) -> Figure:
    """One panel for each stage: every hypothesis as a dot with a line ahead, the better the brighter.

    Panels are turned so that the true vehicle looks to the right.

    Args:
        elements: What to draw of the map.
        stages: Name of each stage, with T_map_base `[n 4 4]` of its hypotheses and their scores `[n]` (lower is better;
            infinite ones are left out).
        reference: True T_map_base, marked by a green ring.
        reach_m: Half length and half width of a panel, along and across the true vehicle.

    Raises:
        SemlocError: no stages.
    """
    if not stages:
        raise SemlocError("search stages: nothing to draw; expected at least one stage with its poses and scores")
    columns = min(len(stages), 2)
    rows = -(-len(stages) // columns)
    figure = new_figure(5.6 * columns, (5.2 * reach_m[1] / reach_m[0] + 0.55) * rows, dark=True)
    grid = figure.subplots(rows, columns, squeeze=False)
    to_truth = np.linalg.inv(reference)
    near = [_moved(element, to_truth) for element in elements if _is_near(element, reference, 2.0 * max(reach_m))]
    for axes, (name, (poses, scores)) in zip(grid.flat, stages.items(), strict=False):
        filled = np.isfinite(scores)
        draw_map(plain_axes(axes, dark=True), near)
        axes.grid(False)
        _draw_hypotheses(axes, to_truth @ poses[filled], scores[filled])
        axes.scatter(0.0, 0.0, s=130, facecolors="none", edgecolors=REFERENCE, linewidths=1.6, zorder=6)
        axes.set_aspect("equal")
        axes.set_xlim(-reach_m[0], reach_m[0])
        axes.set_ylim(-reach_m[1], reach_m[1])
        axes.set_title(name, fontsize=9, color="#e8edf4", loc="left")
    for axes in grid.flat[len(stages) :]:
        axes.set_axis_off()
    for axes in grid[-1]:
        axes.set_xlabel("along the true vehicle [m]", fontsize=8)
    return figure


def _draw_hypotheses(axes: Axes, poses: np.ndarray, scores: np.ndarray) -> None:
    poses = poses[np.argsort(-scores)]
    # By rank, not by value: a few poor ones would take the whole range of colours.
    colours = _SHADES(np.linspace(0.15, 0.98, len(poses)))
    ends = poses[:, :2, 3] + _TICK_M * poses[:, :2, 0]
    lines = np.stack([poses[:, :2, 3], ends], axis=1)
    axes.add_collection(LineCollection(list(lines), colors=colours, linewidths=0.9, zorder=4))
    axes.scatter(*poses[:, :2, 3].T, s=7, c=colours, linewidths=0, zorder=5)


def _is_near(element: MapElement, reference: np.ndarray, radius_m: float) -> bool:
    return bool(np.hypot(*(element.points[:, :2] - reference[:2, 3]).T).min() < radius_m)


def _moved(element: MapElement, T: np.ndarray) -> MapElement:
    return element.with_points(element.points @ T[:3, :3].T + T[:3, 3])
