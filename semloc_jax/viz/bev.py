"""The map from above with the vehicle, its hypotheses and its way (room: viz).

In: map elements, poses T_map_base, trajectories. Out: a Figure, x east and y north, in metres.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from semloc_jax.maps.contours import painted_polygon
from semloc_jax.maps.elements import UPRIGHT_CLASSES, MapElement
from semloc_jax.structs import ElementClass
from semloc_jax.viz.style import COLOURS, ESTIMATE, PRIOR, REFERENCE, class_name, new_figure, plain_axes

VEHICLE_M = np.array([[3.9, 0.0], [3.1, 0.95], [-0.9, 0.95], [-0.9, -0.95], [3.1, -0.95]])
"""Outline of a car from above in the base frame (rear axle at the origin), pointed at the front."""


def draw_map(axes: Axes, elements: Sequence[MapElement], linewidth: float = 1.0) -> tuple[ElementClass, ...]:
    """Draw elements from above: paint as surfaces, upright things as dots, the rest as lines.

    Returns:
        The classes that were drawn, for a legend.
    """
    lines: dict[ElementClass, list[np.ndarray]] = {}
    faces: dict[ElementClass, list[np.ndarray]] = {}
    dots: dict[ElementClass, list[np.ndarray]] = {}
    for element in elements:
        if element.is_logical:
            if element.label == ElementClass.PARKING_SLOT:
                lines.setdefault(element.label, []).append(_closed(element.points[:, :2]))
            continue
        polygon = painted_polygon(element) if element.is_painted else None
        if polygon is not None and not polygon.is_empty:
            faces.setdefault(element.label, []).append(np.asarray(polygon.exterior.coords)[:, :2])
        elif element.label in UPRIGHT_CLASSES:
            dots.setdefault(element.label, []).append(element.points[0, :2])
        else:
            xy = element.points[:, :2]
            lines.setdefault(element.label, []).append(_closed(xy) if element.closed else xy)
    for label, outlines in faces.items():
        # The rim keeps 12 cm of paint visible when a whole drive is in view.
        colour = COLOURS[label]
        axes.add_collection(PolyCollection(outlines, facecolor=colour, edgecolor=colour, linewidth=0.5 * linewidth))
    for label, polylines in lines.items():
        axes.add_collection(LineCollection(polylines, colors=COLOURS[label], linewidths=linewidth))
    for label, places in dots.items():
        axes.scatter(*np.array(places).T, s=14 * linewidth, color=COLOURS[label], edgecolors="black", linewidths=0.4)
    return tuple(sorted({*faces, *lines, *dots}))


def draw_vehicle(axes: Axes, T_map_base: np.ndarray, colour: str, fill: bool = True, alpha: float = 1.0) -> None:
    """Draw the outline of a car at a pose."""
    outline = VEHICLE_M @ np.asarray(T_map_base)[:2, :2].T + np.asarray(T_map_base)[:2, 3]
    axes.fill(*outline.T, facecolor=colour if fill else "none", edgecolor=colour, alpha=alpha, linewidth=1.2, zorder=5)


def _size_in(elements: Sequence[MapElement]) -> tuple[float, float]:
    """Width and height of a figure that elements fill from above, square without any [inch]."""
    if not elements:
        return 8.0, 8.4
    points = np.vstack([element.points[:, :2] for element in elements])
    width, height = np.maximum(np.ptp(points, axis=0), 1.0)
    scale = 9.0 / max(width, height)
    # Labels and legend need some room, whatever the shape.
    return max(scale * width, 4.5) + 0.8, max(scale * height, 2.0) + 1.6


def map_view(
    elements: Sequence[MapElement],
    estimate: np.ndarray | None = None,
    reference: np.ndarray | None = None,
    prior: np.ndarray | None = None,
    hypotheses: Sequence[tuple[float, np.ndarray]] = (),
    center: np.ndarray | None = None,
    radius_m: float | None = None,
    title: str = "",
) -> Figure:
    """The map from above with poses in it.

    Args:
        elements: What to draw.
        estimate: Estimated T_map_base, `[4 4]` or a trajectory `[n 4 4]`.
        reference: True T_map_base, likewise.
        prior: Prior T_map_base, likewise.
        hypotheses: Weight and T_map_base of each mode; heavy ones are drawn more solid.
        center: Middle of the view `[2]` in the map frame; None shows everything.
        radius_m: Half of the side of the view.
        title: Text above the view.
    """
    figure = new_figure(*_size_in(elements if center is None else ()), dark=True)
    axes = plain_axes(figure.add_subplot(), dark=True)
    drawn = draw_map(axes, elements)
    total = max((weight for weight, _ in hypotheses), default=1.0) or 1.0
    for weight, T_map_base in reversed(list(hypotheses)):
        draw_vehicle(axes, T_map_base, ESTIMATE, fill=False, alpha=0.25 + 0.6 * weight / total)
    for poses, colour in ((prior, PRIOR), (reference, REFERENCE), (estimate, ESTIMATE)):
        if poses is not None:
            _draw_poses(axes, np.asarray(poses), colour)
    axes.set_aspect("equal")
    axes.autoscale_view()
    if center is not None and radius_m is not None:
        axes.set_xlim(center[0] - radius_m, center[0] + radius_m)
        axes.set_ylim(center[1] - radius_m, center[1] + radius_m)
    axes.set(xlabel="x east [m]", ylabel="y north [m]", title=title)
    handles = [Line2D([], [], color=COLOURS[label], linewidth=3, label=class_name(label)) for label in drawn]
    names = ((estimate, ESTIMATE, "estimate"), (reference, REFERENCE, "truth"), (prior, PRIOR, "prior"))
    handles += [
        Line2D([], [], color=colour, linewidth=2, label=name) for poses, colour, name in names if poses is not None
    ]
    if handles:
        columns = min(len(handles), 6)
        look = {"fontsize": 8, "frameon": False, "labelcolor": "#e8edf4", "handlelength": 1.4}
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, **look)
    return figure


def _draw_poses(axes: Axes, poses: np.ndarray, colour: str) -> None:
    if poses.ndim == 2:
        draw_vehicle(axes, poses, colour, fill=colour == ESTIMATE, alpha=0.9)
        return
    axes.plot(poses[:, 0, 3], poses[:, 1, 3], color=colour, linewidth=1.4, zorder=4)
    if len(poses):
        draw_vehicle(axes, poses[-1], colour, fill=False)


def _closed(xy: np.ndarray) -> np.ndarray:
    return np.vstack([xy, xy[:1]])
