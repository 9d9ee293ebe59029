"""Paint that a map names but does not draw: bars of dashed lines, strokes of double lines (room: maps; host).

In: a line and sizes. Out: map elements; `assumed` names the sizes that the map does not state.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from semloc_jax.geometry import polyline
from semloc_jax.maps.curves import parallel
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.soundness import fault_of


def strokes(
    line: MapElement, words: Sequence[str], width_m: float, double_gap_m: float, dash_m: float, gap_m: float
) -> list[MapElement]:
    """Returns the painted strokes of a line: one, or two side by side, each solid or in bars.

    Args:
        line: the line; its points are the middle of the paint.
        words: "solid" or "dashed" for each stroke, from the left.
        width_m: width of each stroke.
        double_gap_m: clear distance of two strokes.
        dash_m: length of a bar.
        gap_m: distance from bar to bar.
    """
    shift = 0.5 * (width_m + double_gap_m)
    offsets = [0.0] if len(words) == 1 else [shift, -shift]
    found: list[MapElement] = []
    for side, offset, word in zip(("L", "R"), offsets, words, strict=False):
        points = parallel(line.points, offset) if offset else line.points
        part = replace(line, id=line.id + (side if offset else ""), points=points)
        if word == "dashed":
            found += bars(part, width_m, dash_m, gap_m)
        else:
            found.append(replace(part, width_m=width_m, style="solid"))
    return found


def bars(line: MapElement, width_m: float, dash_m: float, gap_m: float) -> list[MapElement]:
    """Returns the bars of a dashed line, the first half a gap from its start (a short line has one in its middle).

    The true start of each bar is unknown, so bars have no true ends: only their long sides are contours.
    """
    if fault_of(line) is not None:  # the reader of maps leaves it out by its name; its bars would be without number
        return [line]
    along = polyline.arc_length(line.points)
    starts = np.arange(0.5 * gap_m, along[-1] - 0.5 * dash_m, dash_m + gap_m)
    if len(starts) == 0:
        starts = np.array([max(0.5 * (along[-1] - dash_m), 0.0)])
    line = assuming(line, "dashes")
    found = []
    for index, start in enumerate(starts):
        end = min(start + dash_m, along[-1])
        inside = line.points[(along > start) & (along < end)]
        ends = polyline.interpolate(line.points, np.array([start, end]))
        points = np.vstack([ends[:1], inside, ends[1:]])
        values = {"width_m": width_m, "style": "dashed", "true_ends": (False, False)}
        found.append(replace(line, id=f"{line.id}_{index}", points=points, **values))
    return found


def assuming(element: MapElement, what: str) -> MapElement:
    """Returns the element with a note of what the file does not state."""
    assumed = [*element.attributes.get("assumed", []), what]
    return replace(element, attributes={**element.attributes, "assumed": assumed})
