"""Apollo HD maps in the text form of their protocol buffers: base_map.txt (room: maps; host).

In: the .txt file. Out: SemanticMap of lane boundaries, stop lines, crosswalks, traffic lights, stop signs and parking
spaces, in the ENU frame of its origin where the header names the grid, else in the metres of the file.
The format states kinds of paint, but neither widths nor dashes: see ApolloStyle.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from semloc_jax.errors import SemlocError
from semloc_jax.geometry import polyline
from semloc_jax.maps.curves import without_repeats
from semloc_jax.maps.elements import VIRTUAL, GeoOrigin, MapElement
from semloc_jax.maps.io.apollo_grid import placed
from semloc_jax.maps.io.paint import assuming, strokes
from semloc_jax.maps.io.text_format import Message, stream_fields
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.structs import ElementClass

SUFFIXES = (".txt", ".pbtxt", ".prototxt")
_SAME_M = 0.15
"""Two neighbouring lanes both list the boundary between them, up to this far apart; our choice."""
_LONGEST_M = 2e4
"""Lanes end at every crossing; a longer one has a corrupt coordinate. Our choice."""
_WORDS = {"DOTTED": ["dashed"], "SOLID": ["solid"], "DOUBLE": ["solid", "solid"]}
_SILENT = frozenset({"header", "junction", "overlap", "road", "pnc_junction"})
"""Fields without visible elements, or that repeat them."""
_KNOWN = _SILENT | {"lane", "crosswalk", "stop_sign", "signal", "yield", "clear_area", "speed_bump", "parking_space"}
_KNOWN |= {"rsu", "ad_area", "barrier_gate", "parking_lot", "area"}
_FOR_VEHICLES = ("", "NONE", "CITY_DRIVING", "PARKING", "2", "5")
"""Types of lanes, by name and by number, that cars use."""


@dataclass(frozen=True)
class ApolloStyle:
    """Sizes that the format leaves open, after Chinese practice (GB 5768.3); all are our choice."""

    width_m: float = 0.15
    double_gap_m: float = 0.15
    dash_m: float = 2.0
    gap_m: float = 4.0
    fast_dash_m: float = 6.0
    fast_gap_m: float = 9.0
    fast_mps: float = 16.6
    """Lanes with this speed limit or a higher one have the long dashes."""


def read_apollo(path: str | Path, origin: GeoOrigin | None = None, style: ApolloStyle | None = None) -> SemanticMap:
    """Returns the map of an Apollo HD map in text form.

    Args:
        path: the .txt file.
        origin: place of the local frame, for files whose header names the grid; None takes the middle of the map.
        style: widths and dashes that the format leaves open.

    Raises:
        SemlocError: broken text, another kind of message, or an origin for a file without a grid.
    """
    path, style = Path(path), style or ApolloStyle()
    skipped: Counter[str] = Counter()
    lines: list[tuple[MapElement, bool]] = []
    others: list[MapElement] = []
    projection = ""
    for index, (kind, item) in enumerate(stream_fields(path)):
        where = f"map {path.name}: {kind} {index}"
        if kind not in _KNOWN or not isinstance(item, dict):
            raise SemlocError(f"map {path.name}: a field '{kind[:40]}'; expected the text form of an Apollo HD map")
        if kind == "header":
            projection = _word(_first(item, "projection"), "proj")
        elif kind == "lane":
            lines += _boundaries(item, where, style)
        elif kind in _READERS:
            others += _READERS[kind](item, where)
        elif kind not in _SILENT:
            skipped[kind] += 1
    paint = [part for line, is_fast in _once(lines) for part in _painted(line, is_fast, style)]
    elements = _with_own_ids([*paint, *_once_exactly(others)])
    moved, origin, frame = placed(elements, projection, origin, path.name)
    return SemanticMap(tuple(moved), origin, path.name, dict(skipped), frame)


def lane_bounds(path: Path, origin: GeoOrigin | None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields the left and the right boundary of each lane for vehicles, in the frame of `read_apollo`; twice the
    central curve where a boundary is missing.

    Args:
        path: the .txt file.
        origin: that of the map.

    Raises:
        SemlocError: broken text.
    """
    sides: list[MapElement] = []
    projection = ""
    for index, (kind, item) in enumerate(stream_fields(path)):
        if kind == "header" and isinstance(item, dict):
            projection = _word(_first(item, "projection"), "proj")
        if kind != "lane" or not isinstance(item, dict) or _word(item, "type") not in _FOR_VEHICLES:
            continue
        where = f"map {path.name}: lane {index}"
        curves = [_first(_first(item, f"{side}_boundary"), "curve") for side in ("left", "right")]
        found = [_curve(curve, where) for curve in curves]
        if min(len(points) for points, _ in found) < 2:
            found = [_curve(_first(item, "central_curve"), where)] * 2
        if len(found[0][0]) < 2:
            continue
        step = -1 if _word(item, "direction") == "BACKWARD" else 1
        label = ElementClass.LANE_MARKING
        sides += [MapElement(where, label, points[::step], has_height=has_height) for points, has_height in found]
    if sides:
        moved = [side.points for side in placed(sides, projection, origin, path.name)[0]]
        yield from zip(moved[::2], moved[1::2], strict=True)


def _boundaries(lane: Message, where: str, style: ApolloStyle) -> Iterator[tuple[MapElement, bool]]:
    """Yields both boundaries of a lane, a line for each stretch of one kind, with whether its traffic is fast."""
    name = _name(lane, where)
    is_fast = _number(lane, "speed_limit", where, 0.0) >= style.fast_mps
    for side in ("left", "right"):
        boundary = _first(lane, f"{side}_boundary")
        points, has_height = _curve(_first(boundary, "curve"), where)
        if len(points) < 2:
            continue
        length_m = float(polyline.arc_length(points)[-1])
        if length_m > _LONGEST_M:
            raise SemlocError(
                f"{where}: its {side} boundary is {length_m / 1e3:.4g} km long; expected that of one lane"
            )
        is_virtual = _word(boundary, "virtual") in ("true", "True", "t", "1")
        for index, (kind, part) in enumerate(_stretches(boundary, points, where)):
            told = {"apollo": kind, "lane": name}
            colour = kind.rpartition("_")[2].lower()
            told |= {"color": colour} if colour in ("white", "yellow") else {}
            label = ElementClass.CURB if kind == "CURB" else ElementClass.LANE_MARKING
            is_logical = is_virtual or (kind != "CURB" and kind.partition("_")[0] not in _WORDS)
            element_id = f"{name}_{side}" + (f"_{index}" if index else "")
            style_word = VIRTUAL if is_logical else ""
            line = MapElement(element_id, label, part, style=style_word, has_height=has_height, attributes=told)
            yield line, is_fast


def _stretches(boundary: Message, points: np.ndarray, where: str) -> Iterator[tuple[str, np.ndarray]]:
    """Yields the kind and the points of each stretch of a boundary."""
    along = polyline.arc_length(points)
    changes = sorted(
        (_number(entry, "s", where, 0.0), str(entry.get("types", ["UNKNOWN"])[-1]))
        for entry in boundary.get("boundary_type", [])
        if isinstance(entry, dict)
    )
    changes = changes or [(0.0, "UNKNOWN")]
    starts = [0.0, *(min(max(s, 0.0), float(along[-1])) for s, _ in changes[1:]), float(along[-1])]
    for (_, kind), start, end in zip(changes, starts, starts[1:], strict=False):
        inside = points[(along > start) & (along < end)]
        ends = polyline.interpolate(points, np.array([start, end]))
        part = without_repeats(np.vstack([ends[:1], inside, ends[1:]]))
        if len(part) > 1:
            yield kind, part


def _painted(line: MapElement, is_fast: bool, style: ApolloStyle) -> list[MapElement]:
    words = _WORDS.get(line.attributes["apollo"].partition("_")[0], [])
    if line.style == VIRTUAL or not words:
        return [line]
    dash, gap = (style.fast_dash_m, style.fast_gap_m) if is_fast else (style.dash_m, style.gap_m)
    return strokes(assuming(line, "width"), words, style.width_m, style.double_gap_m, dash, gap)


def _once(lines: list[tuple[MapElement, bool]]) -> list[tuple[MapElement, bool]]:
    """Returns the lines without those that run along another one of their kind, which neighbours list as well."""
    lines = list({_place(line): (line, is_fast) for line, is_fast in reversed(lines)}.values())[::-1]
    shapes = [shapely.LineString(line.points[:, :2]) for line, _ in lines]
    bands = shapely.buffer(np.array(shapes, dtype=object), _SAME_M, quad_segs=2)
    dropped: set[int] = set()
    inner, outer = shapely.STRtree(bands).query(np.array(shapes, dtype=object), predicate="within")
    for one, other in sorted(zip(inner.tolist(), outer.tolist(), strict=True)):
        a, b = lines[one][0], lines[other][0]
        is_alike = a.label == b.label and a.style == b.style
        # Of two that lie within each other the first stays.
        is_mutual = is_alike and one < other and bands[one].contains(shapes[other])
        if one != other and is_alike and other not in dropped and not is_mutual:
            dropped.add(one)
    return [line for index, line in enumerate(lines) if index not in dropped]


def _place(line: MapElement) -> tuple[object, ...]:
    """Returns what lines share that are the same, to a centimetre, in either direction."""
    cells = np.rint(line.points * 100.0).astype(np.int64)
    return line.label, line.style, min(cells.tobytes(), cells[::-1].tobytes())


def _crosswalk(item: Message, where: str) -> Iterator[MapElement]:
    yield from _area(item, where, ElementClass.CROSSWALK)


def _parking_space(item: Message, where: str) -> Iterator[MapElement]:
    """Yields a parking space whose first side is its entrance: the one that the heading of a parked car comes from."""
    for area in _area(item, where, ElementClass.PARKING_SLOT):
        if "heading" not in item or len(area.points) != 4:
            yield area
            continue
        heading = _number(item, "heading", where, 0.0)
        sides = 0.5 * (area.points + np.roll(area.points, -1, axis=0)) - area.points.mean(axis=0)
        entrance = int(np.argmin(sides[:, :2] @ [np.cos(heading), np.sin(heading)]))
        yield area.with_points(np.roll(area.points, -entrance, axis=0))


def _area(item: Message, where: str, label: ElementClass) -> Iterator[MapElement]:
    points, has_height = _points(_first(item, "polygon"), where)
    points = without_repeats(points, closed=True)
    if len(points) > 2:
        yield MapElement(_name(item, where), label, points, closed=True, has_height=has_height)


def _sign(item: Message, where: str) -> Iterator[MapElement]:
    """Yields the stop lines of a stop or yield sign, and the sign itself where the file says where it stands."""
    yield from _stop_lines(item, where)
    if "location" in item:
        points, has_height = _points({"point": item["location"][:1]}, where)
        told = {"apollo": "stop_sign"}  # the file states neither size nor height of the plate
        yield MapElement(
            _name(item, where), ElementClass.SIGN, points, style=VIRTUAL, has_height=has_height, attributes=told
        )


def _signal(item: Message, where: str) -> Iterator[MapElement]:
    """Yields the stop lines of a traffic light and its box, upright, as wide as its outline."""
    yield from _stop_lines(item, where)
    points, has_height = _points(_first(item, "boundary"), where)
    if len(points) < 2:
        return
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axis = np.array([[*middle[:2], points[:, 2].min()], [*middle[:2], points[:, 2].max()]])
    width = float(np.linalg.norm(points[:, None, :2] - points[None, :, :2], axis=-1).max())
    is_box = has_height and axis[1, 2] - axis[0, 2] > 0.05 and width > 0.05
    told = {"apollo": _word(item, "type") or "signal"}
    style = "" if is_box else VIRTUAL
    label = ElementClass.TRAFFIC_LIGHT
    light = MapElement(_name(item, where), label, axis, width_m=width, style=style, has_height=has_height)
    yield replace(light, attributes=told)


def _stop_lines(item: Message, where: str) -> Iterator[MapElement]:
    for index, curve in enumerate(item.get("stop_line", [])):
        points, has_height = _curve(curve if isinstance(curve, dict) else {}, where)
        if len(points) > 1:
            line = MapElement(
                f"{_name(item, where)}_stop_{index}", ElementClass.STOP_LINE, points, width_m=0.4, has_height=has_height
            )
            yield assuming(line, "width")


_READERS = {
    "crosswalk": _crosswalk,
    "parking_space": _parking_space,
    "stop_sign": _sign,
    "yield": _sign,
    "signal": _signal,
}


def _once_exactly(elements: list[MapElement]) -> list[MapElement]:
    """Returns the elements without repeats: all lights of a crossing list its stop line."""
    return list({_place(element): element for element in reversed(elements)}.values())[::-1]


def _with_own_ids(elements: list[MapElement]) -> list[MapElement]:
    """Returns the elements with ids that differ: a file numbers its kinds one by one."""
    seen: Counter[str] = Counter()
    found = []
    for element in elements:
        seen[element.id] += 1
        again = seen[element.id]
        found.append(element if again == 1 else replace(element, id=f"{element.id}~{again}"))
    return found


def _curve(curve: Message, where: str) -> tuple[np.ndarray, bool]:
    """Returns the points of all segments of a curve, and whether all have heights."""
    segments = [_first(s, "line_segment") for s in curve.get("segment", []) if isinstance(s, dict)]
    points, has_height = _points({"point": [p for s in segments for p in s.get("point", [])]}, where)
    return without_repeats(points), has_height


def _points(message: Message, where: str) -> tuple[np.ndarray, bool]:
    """Returns a list of points as `float64[k 3]`, and whether all have heights."""
    items = message.get("point", [])
    if not all(isinstance(item, dict) for item in items):
        raise SemlocError(f"{where}: a point cannot be read; expected point {{ x: 1.0 y: 2.0 }}")
    rows = [[_number(item, key, where, 0.0 if key == "z" else None) for key in "xyz"] for item in items]
    has_height = bool(items) and all("z" in item for item in items)
    return np.array(rows, dtype=np.float64).reshape(-1, 3), has_height


def _first(message: Message, key: str) -> Message:
    found = message.get(key, [{}])[0]
    return found if isinstance(found, dict) else {}


def _word(message: Message, key: str) -> str:
    found = message.get(key, [""])[-1]
    return found if isinstance(found, str) else ""


def _name(message: Message, where: str) -> str:
    return _word(_first(message, "id"), "id") or where.rpartition(": ")[2].replace(" ", "_")


def _number(message: Message, key: str, where: str, default: float | None) -> float:
    found: Any = message.get(key, [default])[-1]
    try:
        value = float(found)
    except (TypeError, ValueError):
        value = float("nan")
    if not abs(value) < 1e8:
        raise SemlocError(f"{where}: {key} is '{str(found)[:40]}'; expected a number")
    return value
