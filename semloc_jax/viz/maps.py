"""Two maps of one place over each other, and a map with how sure it is of its elements (room: viz).

In: map elements, their beliefs, poses. Out: a Figure, x east and y north, in metres.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from semloc_jax.maps.beliefs import Belief
from semloc_jax.maps.contours import painted_polygon
from semloc_jax.maps.elements import MapElement
from semloc_jax.viz.bev import draw_map
from semloc_jax.viz.slots import FREE, TAKEN, UNSURE, colour_of
from semloc_jax.viz.style import ESTIMATE, REFERENCE, new_figure, plain_axes

MADE = "#ff4fa3"
_SIGMAS_M = (0.003, 0.3)
"""Range of the colours of sigmas [m]."""
_POST_M = 0.02


def maps_over_each_other(made: Sequence[MapElement], reference: Sequence[MapElement], title: str = "") -> Figure:
    """Outlines of a made map over those of a reference.

    Args:
        made: elements of the made map, in the frame of the reference.
        reference: elements of the reference.
        title: text above the picture.
    """
    figure = new_figure(*_size_in([*made, *reference]), dark=True)
    axes = plain_axes(figure.add_subplot(), dark=True)
    for elements, colour, width in ((reference, REFERENCE, 2.2), (made, MADE, 0.9)):
        axes.add_collection(LineCollection([outline(e) for e in elements], colors=colour, linewidths=width, alpha=0.9))
        _draw_posts(axes, [e for e in elements if _is_post(e)], 10 * width, colour, width)
    handles = [Line2D([], [], color=REFERENCE, label="reference"), Line2D([], [], color=MADE, label="made")]
    axes.legend(handles=handles, fontsize=8, frameon=False, labelcolor="#e8edf4")
    return _finished(figure, axes, title)


def slots_from_above(elements: Sequence[MapElement], slots: Sequence[MapElement], title: str = "") -> Figure:
    """The parking slots of a map, free green, taken red, grey where nothing is told; entrances are white.

    Args:
        elements: all of the map.
        slots: those of them that are slots, the entrance first.
        title: text above the picture.
    """
    figure = new_figure(*_size_in(slots), dark=True)
    axes = plain_axes(figure.add_subplot(), dark=True)
    drawn = {slot.id for slot in slots}
    others = [outline(e) for e in elements if e.id not in drawn and not _is_post(e)]
    axes.add_collection(LineCollection(others, colors="#8a97a6", linewidths=0.6, alpha=0.6))
    taken = [slot.attributes.get("occupied") for slot in slots]
    colours = [UNSURE if told is None else colour_of(bool(told)) for told in taken]
    axes.add_collection(PolyCollection([s.points[:4, :2] for s in slots], facecolors=colours, alpha=0.35))
    axes.add_collection(LineCollection([outline(s) for s in slots], colors=colours, linewidths=1.0))
    axes.add_collection(LineCollection([s.points[:2, :2] for s in slots], colors="#ffffff", linewidths=2.0))
    for slot in slots:
        name = slot.attributes.get("number")
        if name:
            axes.text(*slot.points[:4, :2].mean(axis=0), name, color="#e8edf4", fontsize=6, ha="center", va="center")
    words = (("free", FREE), ("taken", TAKEN), ("not told", UNSURE))
    told = [word for word, value in zip(words, (False, True, None), strict=True) if value in taken]
    handles = [Line2D([], [], color=colour, label=word) for word, colour in told]
    axes.legend(handles=handles, fontsize=8, frameon=False, labelcolor="#e8edf4")
    return _finished(figure, axes, title)


def sigmas_from_above(
    elements: Sequence[MapElement], beliefs: Mapping[str, Belief], poses: np.ndarray, title: str = ""
) -> Figure:
    """A map from above; the colour of each element says how far it may be off across, one standard deviation.

    Args:
        elements: elements of the map.
        beliefs: by id.
        poses: T_map_base `[n 4 4]` of the drive that made it.
        title: text above the picture.
    """
    figure = new_figure(*_size_in(elements), dark=True)
    axes = plain_axes(figure.add_subplot(), dark=True)
    colours = ScalarMappable(LogNorm(*_SIGMAS_M, clip=True), "turbo")
    sigma_m = np.array([beliefs[element.id].sigma_across_m for element in elements])
    draw_map(axes, [element for element in elements if element.is_logical], linewidth=0.4)
    shown = [(outline(e), s) for e, s in zip(elements, sigma_m, strict=True) if not e.is_logical]
    lines = LineCollection([line for line, _ in shown], colors=colours.to_rgba([s for _, s in shown]), linewidths=1.4)
    axes.add_collection(lines)
    posts = [(e, s) for e, s in zip(elements, sigma_m, strict=True) if _is_post(e)]
    _draw_posts(axes, [e for e, _ in posts], 22.0, colours.to_rgba([s for _, s in posts]), 1.4)
    axes.plot(poses[:, 0, 3], poses[:, 1, 3], color=ESTIMATE, linewidth=0.8, alpha=0.7)
    bar = figure.colorbar(colours, ax=axes, shrink=0.6)
    bar.set_label("sigma across [m]", color="#c9d1dc", fontsize=9)
    bar.ax.tick_params(colors="#c9d1dc", labelsize=8)
    return _finished(figure, axes, title)


CHANGES = {"removed": "#ff5c5c", "added": "#5cff9d", "moved": "#ffd24a"}
"""Colours of what changed."""


def changes_from_above(
    elements: Sequence[MapElement], gone: Sequence[MapElement], changed: Mapping[str, str], title: str = ""
) -> Figure:
    """A map from above with what has come (green), gone (red) and moved (yellow).

    Args:
        elements: elements of the map now.
        gone: elements that are no longer in it.
        changed: added or moved, by id of an element.
        title: text above the picture.
    """
    figure = new_figure(*_size_in([*elements, *gone], least_high_in=1.8), dark=True)
    axes = plain_axes(figure.add_subplot(), dark=True)
    groups = [([e for e in elements if e.id not in changed], "#5d6b7d", 0.9), (list(gone), CHANGES["removed"], 1.8)]
    groups += [([e for e in elements if changed.get(e.id) == w], CHANGES[w], 1.8) for w in ("added", "moved")]
    for group, colour, width in groups:
        shown = [e for e in group if not e.is_logical]
        axes.add_collection(LineCollection([outline(e) for e in shown], colors=colour, linewidths=width))
        _draw_posts(axes, [e for e in shown if _is_post(e)], 22.0 * width, colour, width)
    counts = {"removed": len(gone)} | {w: sum(v == w for v in changed.values()) for w in ("added", "moved")}
    handles = [Line2D([], [], color=CHANGES[word], label=f"{count} {word}") for word, count in counts.items()]
    axes.legend(handles=handles, fontsize=9, frameon=False, labelcolor="#e8edf4")
    return _finished(figure, axes, title)


def existence_from_above(elements: Sequence[MapElement], beliefs: Mapping[str, Belief], title: str = "") -> Figure:
    """A map from above twice: in the colours of how likely each element is there, and of how many drives looked at it.

    Args:
        elements: elements of the map.
        beliefs: by id.
        title: text above the picture.
    """
    width_in, height_in = _size_in(elements, least_high_in=1.8)
    figure = new_figure(width_in, 2.0 * height_in, dark=True)
    shown = [element for element in elements if not element.is_logical]
    held = [beliefs[element.id] for element in shown]
    looks = np.array([belief.num_seen + belief.num_missed for belief in held], dtype=float)
    panels = (
        (np.array([b.existence for b in held]), Normalize(0.3, 1.0), "RdYlGn", "probability that it is there"),
        (looks, Normalize(0.0, max(looks.max(initial=0.0), 1.0)), "viridis", "drives that looked at it"),
    )
    for row, (values, scale, name, text) in enumerate(panels, 1):
        axes = plain_axes(figure.add_subplot(2, 1, row), dark=True)
        colours = ScalarMappable(scale, name)
        rgba = colours.to_rgba(values)
        axes.add_collection(LineCollection([outline(e) for e in shown], colors=rgba, linewidths=1.4))
        posts = [k for k, e in enumerate(shown) if _is_post(e)]
        _draw_posts(axes, [shown[k] for k in posts], 22.0, rgba[posts], 1.4)
        bar = figure.colorbar(colours, ax=axes, shrink=0.8, pad=0.01)
        bar.set_label(text, color="#c9d1dc", fontsize=9)
        bar.ax.tick_params(colors="#c9d1dc", labelsize=8)
        _finished(figure, axes, title if row == 1 else "")
    return figure


def _is_post(element: MapElement) -> bool:
    """Whether an element is a point from above."""
    return not element.closed and bool(np.ptp(element.points[:, :2], axis=0).max() < _POST_M)


def _draw_posts(axes: Axes, posts: Sequence[MapElement], size: float, colour: str | np.ndarray, width: float) -> None:
    if posts:
        xy = np.array([post.points[0, :2] for post in posts])
        axes.scatter(*xy.T, s=size, facecolors="none", edgecolors=colour, linewidths=width)


def outline(element: MapElement) -> np.ndarray:
    """The rim of an element from above, `[k 2]`."""
    if element.is_painted and not element.closed and element.width_m > 0.0:
        return np.asarray(painted_polygon(element).exterior.coords)
    xy = element.points[:, :2]
    return np.vstack([xy, xy[:1]]) if element.closed else xy


def _size_in(elements: Sequence[MapElement], least_high_in: float = 4.0) -> tuple[float, float]:
    """Width and height of a picture of a map; a long road would leave no room for a scale of colours."""
    if not elements:
        return 8.0, 6.0
    points = np.vstack([element.points[:, :2] for element in elements])
    width, height = np.maximum(np.ptp(points, axis=0), 1.0)
    scale = 16.0 / max(width, height)
    return max(scale * width, 6.0) + 1.0, max(scale * height, least_high_in) + 0.8


def _finished(figure: Figure, axes: Axes, title: str) -> Figure:
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set(xlabel="x east [m]", ylabel="y north [m]", title=title)
    return figure
