"""How a tracked drive went: errors inside their protection levels, status, timing, Stanford diagram (room: viz).

In: columns of a tracked drive; errors, protection levels and limits by direction. Out: Figures.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from semloc_jax.evaluation.integrity import stanford_counts
from semloc_jax.localization.track_state import TrackStatus
from semloc_jax.viz.style import INK, new_figure, plain_axes

STATUS_COLOURS = {
    TrackStatus.INITIALIZING: "#90a4ae",
    TrackStatus.TRACKING: "#2e7d32",
    TrackStatus.DEGRADED: "#f9a825",
    TrackStatus.LOST: "#c62828",
}
ERROR, LEVEL, LIMIT = "#0d47a1", "#90caf9", "#c62828"


def tracking_over_time(
    time_s: np.ndarray,
    status: Sequence[TrackStatus],
    errors: dict[str, np.ndarray],
    protection: dict[str, np.ndarray],
    limits: dict[str, float],
) -> Figure:
    """Errors inside the band of their protection levels, one row a direction, and the status as a strip below.

    Args:
        time_s: Times of the frames [s].
        status: Of each frame.
        errors: Signed errors by direction, e.g. `lateral [m]`; nan where there is no truth.
        protection: Protection levels by the same names.
        limits: Alert limits by the same names.
    """
    figure = new_figure(10.0, 1.9 * len(errors) + 0.8)
    rows = figure.subplots(
        len(errors) + 1, 1, sharex=True, gridspec_kw={"height_ratios": [*(8 for _ in errors), 1]}, squeeze=False
    )[:, 0]
    time_s = np.asarray(time_s) - time_s[0]
    for axes, name in zip(rows, errors, strict=False):
        _draw_errors(plain_axes(axes), time_s, errors[name], protection[name], limits[name], name)
    _draw_status(rows[-1], time_s, status)
    rows[-1].set_xlabel("time [s]", fontsize=9)
    handles = [Patch(color=colour, label=s.name.lower()) for s, colour in STATUS_COLOURS.items() if s in status]
    handles.append(Patch(color=LEVEL, label="protection level"))
    handles.append(Line2D([], [], color=ERROR, label="error"))
    handles.append(Line2D([], [], color=LIMIT, linestyle=(0, (4, 3)), label="alert limit"))
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), fontsize=8, frameon=False)
    return figure


def _draw_errors(axes: Axes, time_s: np.ndarray, error: np.ndarray, level: np.ndarray, limit: float, name: str) -> None:
    level = np.where(np.isfinite(level), level, 1e3)
    axes.fill_between(time_s, -level, level, color=LEVEL, alpha=0.55, linewidth=0)
    axes.plot(time_s, error, color=ERROR, linewidth=1.1)
    for side in (-limit, limit):
        axes.axhline(side, color=LIMIT, linewidth=0.8, linestyle=(0, (4, 3)))
    reach = _reach(error, level, limit)
    axes.set_ylim(-reach, reach)
    axes.set_ylabel(name, fontsize=9)
    size = np.abs(error[np.isfinite(error)])
    if len(size):
        p95, unit = np.percentile(size, 95), name.rpartition("[")[2].rstrip("]")
        text = f"error: mean {size.mean():.3f}   p95 {p95:.3f}   max {size.max():.3f}   limit ±{limit:g} {unit}"
        axes.set_title(text, loc="left", fontsize=8)


def _reach(error: np.ndarray, level: np.ndarray, limit: float) -> float:
    """Half height of the axes: the whole curve and the limits are inside, whatever the levels are."""
    largest = np.max(np.abs(error[np.isfinite(error)]), initial=0.0)
    level = np.max(level[level < 1.5 * limit], initial=0.0)
    return 1.15 * float(max(largest, level, limit))


def _draw_status(axes: Axes, time_s: np.ndarray, status: Sequence[TrackStatus]) -> None:
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    for time, value in zip(time_s, status, strict=True):
        axes.axvspan(time - 0.5 * step, time + 0.5 * step, color=STATUS_COLOURS[value], linewidth=0)
    axes.set_yticks([])
    axes.tick_params(labelsize=8, length=3, width=0.6)
    for spine in axes.spines.values():
        spine.set_visible(False)


def status_banner(image: np.ndarray, status: TrackStatus, text: str, why: str = "") -> np.ndarray:
    """The image with a bar below that says status and numbers, coloured by status, and a second line that says why.

    Args:
        image: uint8[h w 3], red green blue.
        status: Colour of the bar.
        text: What it says.
        why: What keeps the frame from being TRACKING; what does not fit is cut at a word.
    """
    return banner(image, STATUS_COLOURS[status], text, why)


def banner(image: np.ndarray, colour: str, text: str, more: str = "") -> np.ndarray:
    """The image with a bar below in a colour, and two lines of text in it; as `status_banner`."""
    import cv2

    from semloc_jax.viz.style import rgb

    height = max(image.shape[1] // 24, 24)
    bar = np.full((2 * height, image.shape[1], 3), 20, np.uint8)
    bar[:, : height // 2] = rgb(colour)
    font, scale, grey = cv2.FONT_HERSHEY_SIMPLEX, height / 50.0, (235, 240, 245)
    cv2.putText(bar, text, (height, int(0.7 * height)), font, scale, grey, 1, cv2.LINE_AA)

    def is_fitting(line: str) -> bool:
        return cv2.getTextSize(line, font, 0.8 * scale, 1)[0][0] <= image.shape[1] - 1.5 * height

    words, line = more.split(), ""
    while words and is_fitting(" ".join([line, words[0], "..."])):
        line = " ".join([line, words.pop(0)]).strip()
    line += " ..." if words else ""
    cv2.putText(bar, line, (height, int(1.6 * height)), font, 0.8 * scale, (176, 184, 194), 1, cv2.LINE_AA)
    return np.vstack([image, bar])


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
