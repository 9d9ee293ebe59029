"""What holds the pose of a frame, on the image and from above (room: viz).

In: an Explanation, map samples, images, map elements. Out: Figures: elements in the colour of their share, named where
they are strong; from above also arrows to where the vehicle goes when one of them is wrong.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from semloc_jax.analysis.explanation import Explanation, Holder
from semloc_jax.geometry import rigid
from semloc_jax.maps.contours import painted_polygon
from semloc_jax.maps.elements import UPRIGHT_CLASSES, MapElement
from semloc_jax.viz.bev import VEHICLE_M
from semloc_jax.viz.overlay import Contours
from semloc_jax.viz.style import COLOURS, LIGHT, SHIFT, class_name, new_figure, plain_axes

_FAINT = "#4a5462"
_HEAT = LinearSegmentedColormap.from_list("share", ["#3d5a80", "#2ec4b6", "#ffd166", "#ff7b54", "#ff2e63"])
"""From what hardly holds the pose to what holds it; all of it legible on asphalt."""
_NAMES = ("longitudinal", "lateral", "heading")
_PRIOR_COLOURS = {"prior": "#ffb300", "road": "#8d99ae"}


def share_norm(explanation: Explanation) -> PowerNorm:
    """Shares to colours; small ones are spread, or one strong element would leave all others dark."""
    return PowerNorm(0.5, 0.0, max((100.0 * holder.strength for holder in explanation.elements), default=1.0))


def explained_image(
    panels: Sequence[tuple[str, np.ndarray, Mapping[str, Contours]]],
    explanation: Explanation,
    title: str = "",
    num_named: int = 6,
    width_px: int = 1200,
) -> Figure:
    """The map in the images of a frame, every element in the colour of its share, the strongest named.

    Args:
        panels: Name of each camera, its image uint8[h w 3] (red green blue), contours of each element by its id.
        explanation: What holds the pose.
        title: Text above.
        num_named: How many elements are named.
        width_px: Width of the figure.
    """
    norm, strong = share_norm(explanation), explanation.elements[:num_named]
    columns = 1 if len(panels) == 1 else 2
    rows = -(-len(panels) // columns)
    shape = max(image.shape[0] / image.shape[1] for _, image, _ in panels)
    width_in = width_px / 100.0
    figure = new_figure(width_in, rows * width_in / columns * shape + 0.95, dark=True)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, (name, image, contours) in zip(grid.flat, panels, strict=False):
        picture = np.ascontiguousarray(image).copy()
        # The strong ones last, on top of the others.
        for holder in reversed(explanation.elements):
            if holder.id in contours:
                _draw(picture, contours[holder.id].uv, _HEAT(norm(100.0 * holder.strength)))
        axes.imshow(picture, interpolation="antialiased")
        _name_elements(axes, [(holder, contours[holder.id].uv) for holder in strong if holder.id in contours], picture)
        if len(panels) > 1:
            axes.set_title(name, color=LIGHT, fontsize=9, loc="left", pad=3)
    figure.suptitle(title, color=LIGHT, fontsize=11, x=0.01, ha="left")
    _colour_bar(figure, list(grid.flat), norm)
    return figure


def _draw(picture: np.ndarray, uv: np.ndarray, colour: tuple[float, ...]) -> None:
    fixed = list(np.round(uv * 2**SHIFT).astype(np.int32))
    thick = max(2, round(picture.shape[1] / 480))
    cv2.polylines(picture, fixed, False, (8, 10, 14), thick + 2, cv2.LINE_AA, SHIFT)
    cv2.polylines(picture, fixed, False, tuple(255.0 * c for c in colour[:3]), thick, cv2.LINE_AA, SHIFT)


def _name_elements(axes: Axes, shown: Sequence[tuple[Holder, np.ndarray]], picture: np.ndarray) -> None:
    """Names beside the elements, moved up or down where they would lie on one another."""
    height, width = picture.shape[:2]
    taken: list[tuple[float, float]] = []
    for holder, uv in sorted(shown, key=lambda pair: pair[1][..., 1].mean()):
        u, v = np.median(uv.reshape(-1, 2), axis=0)
        side = 1.0 if u < 0.55 * width else -1.0
        text_u = float(np.clip(u + side * 0.05 * width, 0.02 * width, 0.98 * width))
        text_v = float(np.clip(v - 0.05 * height, 0.05 * height, 0.93 * height))
        # Names are a fifth of the image wide.
        left = text_u if side > 0 else text_u - 0.2 * width
        while any(abs(left - a) < 0.2 * width and abs(text_v - b) < 0.055 * height for a, b in taken):
            text_v += 0.01 * height
        taken.append((left, text_v))
        axes.annotate(
            f"{holder.id[:24]}  {_strongest(holder)}",
            (u, v),
            (text_u, text_v),
            color=LIGHT,
            fontsize=8.5,
            ha="left" if side > 0 else "right",
            bbox={"facecolor": "#10141a", "alpha": 0.72, "edgecolor": "none", "pad": 2.5},
            arrowprops={"arrowstyle": "-", "color": LIGHT, "linewidth": 0.7, "alpha": 0.8},
            annotation_clip=True,
        )


def _strongest(holder: Holder) -> str:
    """The direction that an element constrains most, as text."""
    k = int(np.argmax(holder.share))
    return f"{100.0 * holder.share[k]:.0f} % of {_NAMES[k]}"


def explained_map(
    elements: Sequence[MapElement],
    explanation: Explanation,
    title: str = "",
    num_arrows: int = 6,
    ahead_m: float = 60.0,
) -> Figure:
    """The map from above with the vehicle, every element in the colour of its share, and what holds each direction.

    The view is turned so that the vehicle looks up. An arrow starts at its element and shows where the vehicle goes
    when this element is wrong by `explanation.shift_m`, enlarged as the title of the view says.

    Args:
        elements: Of the map around the vehicle.
        explanation: What holds the pose.
        title: Text above.
        num_arrows: How many arrows, the longest ones.
        ahead_m: What is farther away is left out.
    """
    figure = new_figure(11.6, 8.4, dark=True)
    above, bars = figure.subplots(1, 2, gridspec_kw={"width_ratios": (1.75, 1.0)})
    norm, strength = share_norm(explanation), {holder.id: 100.0 * holder.strength for holder in explanation.elements}
    plain_axes(above, dark=True)
    T_up_map = _ahead_is_up() @ rigid.inverse(explanation.T_map_base)
    placed = [(element, element.points @ T_up_map[:3, :3].T + T_up_map[:3, 3]) for element in elements]
    placed = [(element, points) for element, points in placed if np.linalg.norm(points[:, :2], axis=1).min() < ahead_m]
    for element, points in sorted(placed, key=lambda pair: strength.get(pair[0].id, -1.0)):
        colour = _HEAT(norm(strength[element.id])) if element.id in strength else _FAINT
        _draw_from_above(above, element, points, colour, element.id in strength)
    above.fill(*(VEHICLE_M @ _ahead_is_up()[:2, :2].T).T, facecolor="#ffffff", alpha=0.6, zorder=6)
    _set_limits(above, explanation, T_up_map, ahead_m)
    enlarged = _draw_arrows(above, explanation, T_up_map, num_arrows)
    shift_cm = 100.0 * explanation.shift_m
    above.set_title(
        f"arrow: where the car goes if the element is wrong by {shift_cm:g} cm; 1 cm is {enlarged / 100:g} m long",
        color=LIGHT,
        fontsize=9,
        loc="left",
    )
    above.set_xlabel("to the right [m]")
    above.set_ylabel("ahead [m]")
    _colour_bar(figure, [above, bars], norm)
    _draw_bars(plain_axes(bars, dark=True), explanation)
    figure.suptitle(title, color=LIGHT, fontsize=11, x=0.01, ha="left")
    return figure


def _ahead_is_up() -> np.ndarray:
    """The plane of the picture (right, up) from the vehicle (ahead, left)."""
    T = np.eye(4)
    T[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    return T


def _draw_from_above(axes: Axes, element: MapElement, points: np.ndarray, colour, is_holder: bool) -> None:
    order, wide = (4, 2.2) if is_holder else (2, 0.8)
    if element.is_logical:
        return
    turned = element.with_points(np.column_stack([points[:, :2], element.points[:, 2]]))
    polygon = painted_polygon(turned) if element.is_painted else None
    if polygon is not None and not polygon.is_empty:
        outline = np.asarray(polygon.exterior.coords)[:, :2]
        axes.add_collection(PolyCollection([outline], facecolor=colour, edgecolor=colour, linewidth=wide, zorder=order))
    elif element.label in UPRIGHT_CLASSES:
        size = 42 if is_holder else 10
        axes.scatter(*points[0, :2], s=size, color=[colour], edgecolors="black", linewidths=0.5, zorder=order + 1)
    else:
        xy = np.vstack([points[:, :2], points[:1, :2]]) if element.closed else points[:, :2]
        axes.add_collection(LineCollection([xy], colors=[colour], linewidths=wide, zorder=order))


def _draw_arrows(axes: Axes, explanation: Explanation, T_up_map: np.ndarray, count: int) -> float:
    """Draw the arrows and return by how much they are enlarged."""
    movers = sorted(explanation.elements, key=lambda holder: -np.hypot(*holder.shifted[:2]))[:count]
    longest_m = max((np.hypot(*holder.shifted[:2]) for holder in movers), default=0.0)
    if longest_m <= 0:
        return 100.0
    enlarged = 10.0 ** np.floor(np.log10(9.0 / longest_m)) * np.array([1.0, 2.0, 5.0])
    enlarged = float(enlarged[enlarged <= 9.0 / longest_m][-1])
    (_, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    starts = [(T_up_map[:3, :3] @ holder.middle_map + T_up_map[:3, 3])[:2] for holder in movers]
    height = _spread([start[1] for start in starts], 0.045 * (top - bottom), bottom, top)
    for holder, start, place in zip(movers, starts, height, strict=True):
        step = enlarged * (_ahead_is_up()[:2, :2] @ holder.shifted[:2])
        axes.annotate(
            "",
            start + step,
            start,
            arrowprops={"arrowstyle": "-|>", "color": LIGHT, "linewidth": 1.6, "mutation_scale": 11, "shrinkB": 0},
            zorder=8,
        )
        # Names stand beside the view: in it they would lie on what they name.
        axes.annotate(
            f"{holder.id[:20]}  {100.0 * np.hypot(*holder.shifted[:2]):.1f} cm",
            start,
            (right, place),
            color=LIGHT,
            fontsize=8,
            va="center",
            arrowprops={"arrowstyle": "-", "color": LIGHT, "linewidth": 0.5, "alpha": 0.45},
            zorder=7,
        )
    return enlarged


def _spread(heights: Sequence[float], least: float, bottom: float, top: float) -> np.ndarray:
    """The heights moved apart to at least `least` and kept inside of the view, in their order."""
    order = np.argsort(heights)
    placed = np.asarray(heights, np.float64)[order]
    for k in range(1, len(placed)):
        placed[k] = max(placed[k], placed[k - 1] + least)
    placed -= max(placed[-1] - (top - least), 0.0)
    placed += max(bottom + least - placed[0], 0.0)
    spread = np.empty_like(placed)
    spread[order] = placed
    return spread


def _set_limits(axes: Axes, explanation: Explanation, T_up_map: np.ndarray, ahead_m: float) -> None:
    """Limits of the view: the vehicle and all that holds it."""
    middles = np.array([holder.middle_map for holder in explanation.elements] or [explanation.T_map_base[:3, 3]])
    seen = (middles @ T_up_map[:3, :3].T + T_up_map[:3, 3])[:, :2]
    seen = np.clip(np.vstack([seen, [[0.0, 0.0]]]), -ahead_m, ahead_m)
    low, high = seen.min(axis=0), seen.max(axis=0)
    half = max(0.5 * (high[1] - low[1]) * 0.45, 0.5 * (high[0] - low[0]), 9.0) + 7.0
    middle = 0.5 * (low[0] + high[0])
    axes.set_aspect("equal")
    axes.set_xlim(middle - half, middle + half)
    axes.set_ylim(low[1] - 7.0, high[1] + 7.0)


def _draw_bars(axes: Axes, explanation: Explanation) -> None:
    """What each direction is held by, class by class, and how well."""
    groups = [(class_name(holder.label), COLOURS[holder.label], holder.share) for holder in explanation.classes]
    rest = [holder for holder in explanation.holders if not holder.is_element]
    groups += [({"prior": "prior"}.get(h.id, "height, tilt of road"), _PRIOR_COLOURS[h.id], h.share) for h in rest]
    bottom = np.zeros(3)
    for _, colour, share in groups:
        axes.bar(range(3), 100.0 * share, 0.62, bottom, color=colour, edgecolor="#161a21", linewidth=0.8)
        for k in range(3):
            if share[k] > 0.05:
                at = bottom[k] + 50.0 * share[k]
                axes.text(k, at, f"{100.0 * share[k]:.0f}", ha="center", va="center", fontsize=8, color="#10141a")
        bottom += 100.0 * share
    lon, lat, heading = explanation.sigma
    texts = (f"{100 * lon:.1f} cm", f"{100 * lat:.1f} cm", f"{np.degrees(heading):.2f}°")
    axes.set_xticks(range(3), [f"{name}\nsigma {text}" for name, text in zip(_NAMES, texts, strict=True)])
    axes.set_ylim(0.0, 100.0)
    axes.grid(False)
    axes.set_title("what holds each direction [%]", color=LIGHT, fontsize=9, loc="left")
    handles = [Patch(color=colour, label=name) for name, colour, share in groups if share.max() > 0.004]
    axes.legend(
        handles=handles[::-1],
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        fontsize=8,
        frameon=False,
        labelcolor=LIGHT,
        handlelength=0.9,
        handleheight=0.9,
    )


def _colour_bar(figure: Figure, axes: list[Axes], norm: PowerNorm) -> None:
    bar = figure.colorbar(
        ScalarMappable(norm, _HEAT), ax=axes, location="bottom", aspect=60, fraction=0.03, pad=0.015, shrink=0.6
    )
    bar.set_label("share of what holds the pose, mean of the three directions [%]", color=LIGHT, fontsize=8)
    bar.ax.tick_params(labelsize=8, colors=LIGHT)
    bar.outline.set_visible(False)
