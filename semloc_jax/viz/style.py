"""Colours by class, empty figures and files, the same for every picture (room: viz).

In: classes, figures, image arrays. Out: colours, matplotlib Figures on the Agg backend, PNG files.
Image arrays are uint8[h w 3] in the order red green blue, as matplotlib shows them.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from semloc_jax.errors import SemlocError
from semloc_jax.storage import writing
from semloc_jax.structs import ElementClass

COLOURS: dict[ElementClass, str] = {
    ElementClass.LANE_MARKING: "#00e5ff",
    ElementClass.STOP_LINE: "#ff5252",
    ElementClass.CROSSWALK: "#ffc400",
    ElementClass.ROAD_MARK: "#f4ff81",
    ElementClass.SLOT_LINE: "#64ffda",
    ElementClass.PARKING_SLOT: "#26a69a",
    ElementClass.SPEED_BUMP: "#ff9e40",
    ElementClass.POLE: "#ff4fa3",
    ElementClass.SIGN: "#b388ff",
    ElementClass.TRAFFIC_LIGHT: "#76ff03",
    ElementClass.PILLAR: "#ff8a80",
    ElementClass.CONE: "#ff6d00",
    ElementClass.CURB: "#bcaaa4",
    ElementClass.GUARDRAIL: "#90a4ae",
}
"""Bright and far apart in hue: legible on asphalt, on sky and at night."""

ASPHALT = "#161a21"
LIGHT = "#e8edf4"
"""Words on asphalt."""
PLAN_BACK, PLAN_INK = (18, 20, 24), (215, 222, 230)
"""Ground and words of plans that are drawn into films."""
SHIFT = 4
"""Lines are drawn in sixteenths of a pixel."""
PAPER = "#ffffff"
INK = "#20242c"
ESTIMATE, REFERENCE, PRIOR = "#ffffff", "#00e676", "#ffb300"
"""Vehicle poses on a dark ground: estimate white, truth green, prior amber."""


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue 0...255 of a colour `#rrggbb`."""
    value = int(colour.lstrip("#"), 16)
    return value >> 16, value >> 8 & 255, value & 255


def class_name(label: ElementClass | int) -> str:
    """The name of a class as a person reads it, e.g. `lane marking`."""
    return ElementClass(label).name.lower().replace("_", " ")


def new_figure(width_in: float, height_in: float, dark: bool = False, dpi: float = 100.0) -> Figure:
    """An empty figure that belongs to no window and no global state."""
    figure = Figure(figsize=(width_in, height_in), dpi=dpi, facecolor=ASPHALT if dark else PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plain_axes(axes: Axes, dark: bool = False) -> Axes:
    """Axes with thin lines, a faint grid and no box."""
    ink = "#c9d1dc" if dark else INK
    axes.set_facecolor(ASPHALT if dark else PAPER)
    axes.tick_params(colors=ink, labelsize=8, length=3, width=0.6)
    axes.grid(True, color=ink, alpha=0.12, linewidth=0.6)
    axes.set_axisbelow(True)
    for name, spine in axes.spines.items():
        spine.set_visible(name in ("left", "bottom"))
        spine.set_color(ink)
        spine.set_linewidth(0.6)
    for text in (axes.xaxis.label, axes.yaxis.label, axes.title):
        text.set_color(ink)
        text.set_fontsize(9)
    return axes


def to_image(picture: Figure | np.ndarray) -> np.ndarray:
    """The picture as uint8[h w 3], red green blue."""
    if isinstance(picture, np.ndarray):
        return picture
    picture.canvas.draw()
    return np.asarray(picture.canvas.buffer_rgba())[..., :3].copy()


def save(picture: Figure | np.ndarray, path: str | Path) -> Path:
    """Write a figure or an image array to a PNG file and return its path.

    Raises:
        SemlocError: the file cannot be written.
    """
    path = Path(path)
    try:
        with writing(path) as partial:
            is_written = cv2.imwrite(str(partial), to_image(picture)[..., ::-1])
            if not is_written:
                raise OSError
    except (OSError, cv2.error) as error:
        raise SemlocError(
            f"picture {path}: cannot be written; give a path ending in .png in a folder that exists"
        ) from error
    return path


def sheet(tiles: Sequence[np.ndarray], columns: int = 2) -> np.ndarray:
    """Pictures of one width side by side and below each other, each in a cell of the height of the tallest.

    Cells that nothing fills are black. One picture stands alone.
    """
    height, columns = max(tile.shape[0] for tile in tiles), min(columns, len(tiles))
    cells = [np.pad(tile, ((0, height - tile.shape[0]), (0, 0), (0, 0))) for tile in tiles]
    cells += [np.zeros_like(cells[0])] * (-len(cells) % columns)
    return np.vstack([np.hstack(cells[k : k + columns]) for k in range(0, len(cells), columns)])
