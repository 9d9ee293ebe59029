"""What each type of Lanelet2 way looks like (room: maps; host).

In: tags and points of one way. Out: map elements; paint that the format leaves open is laid out after Lanelet2Style.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from semloc_jax.maps.curves import both_sides, without_repeats
from semloc_jax.maps.elements import VIRTUAL, MapElement
from semloc_jax.maps.io.paint import assuming, bars, strokes
from semloc_jax.structs import ElementClass

LOGICAL_TYPES = frozenset({"virtual", "road_border", "bulb", "light_bulbs"})
"""Types that are no visible contour by design; their absence is nothing to report."""

_AREAS = {
    "speed_bump": ElementClass.SPEED_BUMP,
    "symbol": ElementClass.ROAD_MARK,
    "arrow": ElementClass.ROAD_MARK,
    "crosswalk_polygon": ElementClass.CROSSWALK,
}
_LINES = {
    "curbstone": ElementClass.CURB,
    "guard_rail": ElementClass.GUARDRAIL,
    "stop_line": ElementClass.STOP_LINE,
    "zebra_marking": ElementClass.CROSSWALK,
    "pedestrian_marking": ElementClass.CROSSWALK,
    "bike_marking": ElementClass.LANE_MARKING,
    "line_thin": ElementClass.LANE_MARKING,
    "line_thick": ElementClass.LANE_MARKING,
}
_EDGES = frozenset({"curbstone", "guard_rail", "zebra_marking"})
"""Line types that are one edge without a width; a zebra marking runs along the ends of its bars."""


@dataclass(frozen=True)
class Lanelet2Style:
    """Sizes that Lanelet2 leaves open. All are our choice, after German practice (RMS); a `width` tag has precedence.

    Elements that rest on them have the attribute `assumed`: a list of "width" and "dashes".
    """

    thin_width_m: float = 0.12
    thick_width_m: float = 0.25
    stop_line_width_m: float = 0.5
    double_gap_m: float = 0.12
    """Clear distance of the two strokes of a double line."""
    dash_m: float = 3.0
    gap_m: float = 6.0
    crossing_dash_m: float = 0.5
    """Bars of the dashed edges of pedestrian and cycle crossings, and the gaps between them."""
    crossing_gap_m: float = 0.2


def elements_from_way(
    way_id: str, tags: Mapping[str, Any], points: np.ndarray, has_height: bool, style: Lanelet2Style
) -> list[MapElement]:
    """Returns the visible elements of one way: several for dashed and double lines, none for logical ways.

    Args:
        way_id: id in the file.
        tags: tags of the way; kept as attributes.
        points: its nodes in the map frame, `[k 3]` [m].
        has_height: whether the nodes came with heights.
        style: sizes that the format leaves open.
    """
    kind, subtype = tags.get("type", ""), tags.get("subtype", "")
    is_loop = len(points) > 3 and bool(np.array_equal(points[0], points[-1]))
    points = without_repeats(points)
    if len(points) < 2:
        return []
    base = MapElement(way_id, ElementClass.LANE_MARKING, points, has_height=has_height, attributes=dict(tags))
    if kind == "traffic_sign":
        return [_sign(base, _number(tags, "height"))]
    if kind == "traffic_light":
        return [_upright(base, ElementClass.TRAFFIC_LIGHT, _number(tags, "height"))]
    if kind == "pole":
        return [_upright(base, ElementClass.POLE, _number(tags, "height"))]
    if kind == "parking_space" and len(points) == 2 and _number(tags, "width") > 0:
        return [_parking_slot(base, _number(tags, "width"))]
    if kind in _AREAS:
        closed = is_loop or (tags.get("area") == "yes" and len(points) > 2)
        outline = points[:-1] if is_loop else points
        return [_of(base, _AREAS[kind], outline, closed=closed, style="" if closed else VIRTUAL, shape=str(subtype))]
    if kind in _LINES:
        return _line(_of(base, _LINES[kind], points), kind, str(subtype), style)
    return []


def _line(base: MapElement, kind: str, subtype: str, style: Lanelet2Style) -> list[MapElement]:
    """Returns the painted strokes of a line way."""
    width = _number(base.attributes, "width")
    if width == 0.0 and kind not in _EDGES:
        base = assuming(base, "width")
    if kind in _EDGES:
        return [_of(base, base.label, base.points, style="solid")]
    if kind in ("pedestrian_marking", "bike_marking"):
        return bars(base, width or style.thin_width_m, style.crossing_dash_m, style.crossing_gap_m)
    if kind == "stop_line":
        return [_of(base, base.label, base.points, width_m=width or style.stop_line_width_m, style="solid")]
    width = width or (style.thick_width_m if kind == "line_thick" else style.thin_width_m)
    words = [word for word in subtype.split("_") if word in ("solid", "dashed")] or ["solid"]
    return strokes(base, words, width, style.double_gap_m, style.dash_m, style.gap_m)


def _sign(base: MapElement, height_m: float) -> MapElement:
    """Returns the upright rectangle above the lower edge of a sign; not sampled where its height is unknown."""
    left, right = base.points[0], base.points[-1]
    if not (base.has_height and height_m > 0):
        return _of(base, ElementClass.SIGN, base.points, style=VIRTUAL)
    up = np.array([0.0, 0.0, height_m])
    across = right - left
    normal = np.array([-across[1], across[0], 0.0]) / max(float(np.hypot(across[0], across[1])), 1e-9)
    outline = np.stack([left, right, right + up, left + up])
    # From left to right as a driver sees it, so the face looks back along z-up cross the edge.
    return _of(base, ElementClass.SIGN, outline, closed=True, shape="rectangle", normal=-normal)


def _upright(base: MapElement, label: ElementClass, height_m: float) -> MapElement:
    """Returns base and top of a pole or of the box of a traffic light; not sampled where the height is unknown."""
    first, last = base.points[0], base.points[-1]
    across_m = float(np.hypot(*(last - first)[:2]))
    if base.has_height and label == ElementClass.POLE and abs(last[2] - first[2]) > across_m:
        axis = np.stack([first, last] if last[2] > first[2] else [last, first])
    elif base.has_height and height_m > 0:
        middle = 0.5 * (first + last)
        axis = np.stack([middle, middle + [0.0, 0.0, height_m]])
    else:
        return _of(base, label, np.stack([first, last]), style=VIRTUAL)
    radius_m = _number(base.attributes, "radius")
    width_m = across_m if label == ElementClass.TRAFFIC_LIGHT else 0.0
    return _of(base, label, axis, width_m=width_m, radius_m=radius_m, radius_top_m=radius_m)


def _parking_slot(base: MapElement, width_m: float) -> MapElement:
    left, right = both_sides(base.points, 0.5 * width_m)
    return _of(base, ElementClass.PARKING_SLOT, np.vstack([right, left[::-1]]), closed=True)


def _of(base: MapElement, label: ElementClass, points: np.ndarray, name: str = "", **values: Any) -> MapElement:
    """Returns an element of the same way with another class, geometry and size."""
    return replace(base, id=base.id + name, label=label, points=points, **values)


def _number(tags: Mapping[str, Any], key: str) -> float:
    """Returns a positive size from a tag such as `0.15` or `0.15 m`; 0 where there is none."""
    try:
        value = float(str(tags.get(key, "0")).split()[0])
    except (ValueError, IndexError):
        return 0.0
    return value if np.isfinite(value) and value > 0 else 0.0
