"""Slices through the cost around a pose, with their minima (room: viz).

In: cost values on a grid of two of the six directions; or a localizer, the masks of a frame, a pose. Out: minima, a
Figure with one panel for each class.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.analysis.landscape import frame_landscape
from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.viz.style import INK, new_figure, plain_axes

_ROOM_OF_A_LABEL = (0.16, 0.05)
"""Of the width and height of a panel."""
DIRECTIONS = {
    "x": ("longitudinal", "m"),
    "y": ("lateral", "m"),
    "z": ("height", "m"),
    "roll": ("roll", "deg"),
    "pitch": ("pitch", "deg"),
    "yaw": ("heading", "deg"),
}
"""The six directions of the vehicle's tangent, in its order, with the unit they are shown in."""


@dataclass(frozen=True)
class CostSlice:
    """Cost over two directions about a pose.

    Args:
        directions: Names of the two directions, keys of `DIRECTIONS`.
        offset_a, offset_b: Offsets along them, in metres or degrees, `float[na]` and `float[nb]`.
        cost: `float[na nb]` in [0, 1]; NaN where there is nothing to see.
    """

    directions: tuple[str, str]
    offset_a: np.ndarray
    offset_b: np.ndarray
    cost: np.ndarray

    def __post_init__(self) -> None:
        if self.cost.shape != (len(self.offset_a), len(self.offset_b)) or not set(self.directions) <= set(DIRECTIONS):
            raise SemlocError(
                f"cost slice over {self.directions}: got cost {self.cost.shape} for {len(self.offset_a)} x "
                f"{len(self.offset_b)} offsets; expected directions among {', '.join(DIRECTIONS)} and one cost for each"
            )


@dataclass(frozen=True)
class Minimum:
    """A local minimum of a slice: offsets along its two directions, and the cost there."""

    offset_a: float
    offset_b: float
    cost: float


def find_minima(piece: CostSlice, count: int = 5, depth: float = 0.02) -> list[Minimum]:
    """Distinct minima of a slice, lowest first, refined between the grid points by a parabola along each direction.

    Args:
        piece: The slice.
        count: At most so many.
        depth: To leave a minimum towards a lower one, the cost must rise by at least this much.
    """
    from skimage import measure, morphology  # takes longer to import than all else here

    known = np.isfinite(piece.cost)
    if not known.any() or np.ptp(piece.cost[known]) <= depth:
        return []
    cost = np.where(known, piece.cost, piece.cost[known].max() + 2 * depth)
    basins = measure.label(morphology.h_minima(cost, depth))
    bottoms = [region.coords[np.argmin(cost[tuple(region.coords.T)])] for region in measure.regionprops(basins)]
    bottoms.sort(key=lambda place: cost[tuple(place)])
    return [
        Minimum(_refine(piece.offset_a, cost[:, j], i), _refine(piece.offset_b, cost[i, :], j), float(cost[i, j]))
        for i, j in (place.tolist() for place in bottoms[:count])
    ]


def landscape(slices: Mapping[str, CostSlice], title: str = "", truth: tuple[float, float] | None = None) -> Figure:
    """One panel for each slice, on one scale, with the minima numbered from the lowest.

    Args:
        slices: Name (e.g. of the class) and slice; all over the same two directions.
        title: Text above the panels.
        truth: Offsets of the true pose, marked by a cross.
    """
    if not slices:
        raise SemlocError("landscape: no cost slices to draw; expected at least one class with map elements in view")
    columns = min(len(slices), 3)
    rows = -(-len(slices) // columns)
    figure = new_figure(4.2 * columns + 0.6, 3.9 * rows + 0.4)
    grid = figure.subplots(rows, columns, squeeze=False)
    finite = np.concatenate([piece.cost[np.isfinite(piece.cost)].ravel() for piece in slices.values()])
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    image = None
    for axes, (name, piece) in zip(grid.flat, slices.items(), strict=False):
        image = _draw_slice(plain_axes(axes), name, piece, (low, max(high, low + 1e-6)), truth)
    for axes in grid.flat[len(slices) :]:
        axes.set_axis_off()
    bar = figure.colorbar(image, ax=grid, shrink=0.8, pad=0.02)
    bar.set_label("cost: 0 explains the map in view, 1 nothing of it", fontsize=8, color=INK)
    bar.ax.tick_params(labelsize=8)
    words = "red circles: minima with their cost, 1 is the lowest      white areas: nothing of it in view"
    figure.supxlabel(words + ("      white cross: true pose" if truth is not None else ""), fontsize=8, color=INK)
    figure.suptitle(title, fontsize=10, color=INK)
    return figure


def _draw_slice(axes, name: str, piece: CostSlice, limits: tuple[float, float], truth: tuple[float, float] | None):
    a, b = piece.offset_a, piece.offset_b
    image = axes.pcolormesh(a, b, piece.cost.T, cmap="viridis", vmin=limits[0], vmax=limits[1], shading="nearest")
    axes.grid(False)
    if np.isfinite(piece.cost).all() and min(piece.cost.shape) > 1 and np.ptp(piece.cost) > 0:
        axes.contour(a, b, piece.cost.T, levels=8, colors="white", linewidths=0.4, alpha=0.5)
    written: list[np.ndarray] = []
    for rank, minimum in enumerate(find_minima(piece), start=1):
        place = minimum.offset_a, minimum.offset_b
        axes.scatter(*place, s=46, facecolors="none", edgecolors="#ff1744", linewidths=1.4, zorder=4)
        shares = np.array(place) / [max(np.ptp(a), 1e-9), max(np.ptp(b), 1e-9)]
        if any((np.abs(shares - other) < _ROOM_OF_A_LABEL).all() for other in written):
            continue  # the circle is there; two labels over each other cannot be read
        written.append(shares)
        label = f"{rank}  {minimum.cost:.3f}"
        axes.annotate(label, place, xytext=(6, 5), textcoords="offset points", fontsize=7, color="#ffffff")
        axes.texts[-1].set_path_effects([withStroke(linewidth=1.5, foreground="#202428")])
    if truth is not None:
        axes.scatter(*truth, marker="+", s=70, color="white", linewidths=1.4, zorder=5)
    axes.set_xlabel(_axis_text(piece.directions[0]), fontsize=9)
    axes.set_ylabel(_axis_text(piece.directions[1]), fontsize=9)
    axes.set_title(name, fontsize=9)
    return image


def _axis_text(direction: str) -> str:
    name, unit = DIRECTIONS[direction]
    return f"{name} [{unit}]"


def _refine(offset: np.ndarray, cost: np.ndarray, index: int) -> float:
    """Place of the minimum between grid points, by the parabola through the point and its two neighbours."""
    if 0 < index < len(cost) - 1 and np.isfinite(cost[index - 1 : index + 2]).all():
        before, here, after = cost[index - 1 : index + 2]
        curvature = before - 2 * here + after
        if curvature > 0:
            step = 0.5 * (offset[index + 1] - offset[index - 1])
            return float(offset[index] + 0.5 * (before - after) / curvature * step)
    return float(offset[index])


def slices_of_frame(
    localizer: FrameLocalizer,
    masks: Sequence[np.ndarray],
    rig: Rig,
    T_map_base: np.ndarray,
    directions: tuple[str, str],
    extent: tuple[float, float],
    level: int = 1,
    steps: tuple[int, int] = (61, 61),
) -> dict[str, CostSlice]:
    """Slices of one frame around a pose: `all` classes together, then each mask channel in view alone.

    Args:
        localizer: Map, class table and configuration.
        masks: Class ids of every camera of the rig.
        rig: Cameras of the masks.
        T_map_base: Pose in the middle, in the map frame.
        directions: Two of x, y, z, roll, pitch, yaw.
        extent: Half width along each [m or deg].
        level: Level of the cost maps, 0 is the coarsest.
        steps: Number of poses along each; a single one stands in the middle.

    Raises:
        SemlocError: wrong directions, or a level that the cost maps do not have.
    """
    offsets = [
        np.linspace(-half, half, num) if num > 1 else np.zeros(1) for half, num in zip(extent, steps, strict=True)
    ]
    in_si = [
        np.deg2rad(offset) if DIRECTIONS.get(direction, ("", ""))[1] == "deg" else offset
        for direction, offset in zip(directions, offsets, strict=True)
    ]
    costs = frame_landscape(localizer, masks, rig, T_map_base, directions, *in_si, level)
    return {name: CostSlice(directions, *offsets, cost) for name, cost in costs.items()}
