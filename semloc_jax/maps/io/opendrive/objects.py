"""Objects beside and on an OpenDRIVE road: poles, crosswalks, parking spaces, rails, arrows (room: maps; host).

In: the <object> elements of a Road. Out: map elements, and the types that were left out.
Outlines in road coordinates are moved with a repetition by its distance from the place of the object.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry import polyline
from semloc_jax.maps.curves import as_ring, simplify, without_repeats
from semloc_jax.maps.elements import VIRTUAL, MapElement
from semloc_jax.maps.io.opendrive.marks import OpenDriveStyle
from semloc_jax.maps.io.opendrive.road import Road
from semloc_jax.maps.io.xml_stream import number, numbers
from semloc_jax.structs import ElementClass

_POLES = frozenset({"pole", "streetlamp", "lamppost", "guide-post", "guidepost", "delineator", "bollard"})
_RAILS = frozenset({"railing", "guardrail", "guard-rail", "crashbarrier"})
_PAINT = {
    "crosswalk": ElementClass.CROSSWALK,
    "parkingspace": ElementClass.SLOT_LINE,
    "stopline": ElementClass.STOP_LINE,
    "roadmark": ElementClass.ROAD_MARK,
    "arrow": ElementClass.ROAD_MARK,
}
_AREAS = {**_PAINT, "parkingspace": ElementClass.PARKING_SLOT, "speedbump": ElementClass.SPEED_BUMP}
_PILLARS = frozenset({"pillar", "column"})
_MOST_COPIES = 20_000
_MOST_BARS = 2_000
_SHORTEST_PERIOD_M = 0.05


@dataclass(frozen=True)
class _Copy:
    """One place of an object: all lengths in metres, angles in radians."""

    s: float
    t: float
    z: float
    hdg: float
    length: float
    width: float
    height: float
    radius: float


def object_elements(road: Road, style: OpenDriveStyle, skip: Callable[[str], None]) -> Iterator[MapElement]:
    """Yields the visible objects of a road.

    Args:
        road: the road.
        style: sizes that the file leaves open.
        skip: told the type of what is left out.
    """
    for xml in road.xml.findall("objects/object"):
        kind = _kind(xml)
        if kind not in _POLES and kind not in _RAILS and kind not in _AREAS and kind not in _PILLARS:
            skip(xml.get("type", "object"))
            continue
        name = f"r{road.id}_o{xml.get('id', '')}"
        attributes = {"opendrive": xml.get("type", ""), "name": xml.get("name", "")}
        for index, (copy, length_m) in enumerate(_copies(xml, road)):
            part = name if index == 0 else f"{name}_{index}"
            if kind in _RAILS:
                yield from _rail(road, xml, copy, length_m, part, attributes)
            elif kind in _POLES:
                yield _pole(road, copy, part, attributes)
            else:
                yield from _area(road, xml, copy, kind, part, attributes, style)


def _kind(xml: Element) -> str:
    """Returns what an object is, from its type, subtype or name, in small letters."""
    kind, subtype, name = (xml.get(key, "").lower() for key in ("type", "subtype", "name"))
    known = _POLES | _RAILS | set(_AREAS) | _PILLARS
    if subtype in known or kind in ("barrier", "pole", "roadmark", "none", "obstacle", "", "-1"):
        words = [word for word in sorted(known) if word == subtype or word == name.replace(" ", "")]
        if words:
            return words[0]
    if kind == "roadmark" and "stop" in f"{subtype} {name}":
        return "stopline"
    return kind


def _copies(xml: Element, road: Road) -> Iterator[tuple[_Copy, float]]:
    """Yields the places of an object, each with the length of way it is stretched over (0 if it is not)."""
    s, t, z, hdg = numbers(xml, "s t zOffset hdg", road.where)
    size = [max(value, 0.0) for value in numbers(xml, "length width height radius", road.where, 1e5)]
    repeats = xml.findall("repeat")
    if not repeats:
        yield _Copy(s, t, z, hdg, *size), 0.0
        return
    for repeat in repeats:
        start, way, distance = (number(repeat, key, road.where, limit=1e6) for key in ("s", "length", "distance"))
        if distance <= 0.0:
            yield _at_share(repeat, road, start, t, z, hdg, size, 0.0), max(min(way, road.length - start), 0.0)
            continue
        if distance < _SHORTEST_PERIOD_M or way / distance > _MOST_COPIES:
            raise SemlocError(f"{road.where}: an object every {distance:g} m over {way:g} m; expected at least 5 cm")
        for k in range(int(np.floor(way / distance + 1e-9)) + 1):
            place = start + k * distance
            if place <= road.length + 1e-6:
                yield _at_share(repeat, road, place, t, z, hdg, size, k * distance / max(way, 1e-9)), 0.0


def _at_share(
    repeat: Element, road: Road, s: float, t: float, z: float, hdg: float, size: list[float], share: float
) -> _Copy:
    """Returns the copy of an object at a share of its repetition."""

    def between(key: str, usual: float) -> float:
        first = number(repeat, f"{key}Start", road.where, usual)
        return first + share * (number(repeat, f"{key}End", road.where, first) - first)

    keys = ("length", "width", "height", "radius")
    sizes = [between(key, usual) for key, usual in zip(keys, size, strict=True)]
    return _Copy(s, between("t", t), between("zOffset", z), hdg, *sizes)


def _pole(road: Road, copy: _Copy, name: str, attributes: dict[str, Any]) -> MapElement:
    """Returns a pole; not sampled where its height is unknown."""
    base = road.locate(np.array([copy.s]), np.array([copy.t]), copy.z)[0]
    radius = copy.radius or 0.5 * (copy.width or copy.length)
    axis = np.stack([base, base + [0.0, 0.0, copy.height or 1.0]])
    style = "" if copy.height > 0.0 else VIRTUAL
    return MapElement(
        name, ElementClass.POLE, axis, radius_m=radius, radius_top_m=radius, style=style, attributes=attributes
    )


def _rail(
    road: Road, xml: Element, copy: _Copy, length_m: float, name: str, attributes: dict[str, Any]
) -> Iterator[MapElement]:
    """Yields a rail along the road, as the middle of its beam."""
    corners = _corners(road, xml, copy)
    end = min(copy.s + (length_m or copy.length), road.length)
    if len(corners) > 1:
        points = corners
    elif end - copy.s > 0.1:
        s = road.between(copy.s, end)
        points = simplify(road.locate(s, np.full_like(s, copy.t), copy.z), 0.005)
    else:
        return
    middle = points + [0.0, 0.0, 0.5 * copy.height]
    top_m = copy.z + copy.height
    yield MapElement(name, ElementClass.GUARDRAIL, middle, height_m=max(top_m, 0.0), attributes=attributes)


def _area(
    road: Road, xml: Element, copy: _Copy, kind: str, name: str, attributes: dict[str, Any], style: OpenDriveStyle
) -> Iterator[MapElement]:
    """Yields the painted strokes of an object, and its outline where that is what can be seen."""
    corners = _corners(road, xml, copy)
    has_outline = len(corners) >= 3
    if not len(corners):
        corners = _box(road, copy)
    painted = list(_marking_elements(road, xml, corners, kind, name, attributes))
    yield from painted
    if len(corners) < 3 or (painted and kind != "parkingspace"):
        return
    if kind in _PILLARS:
        if copy.height > 0.0:
            yield MapElement(
                name, ElementClass.PILLAR, corners, closed=True, height_m=copy.height, attributes=attributes
            )
        return
    if kind == "stopline" and not has_outline:
        line = 0.5 * (corners[[0, 1]] + corners[[3, 2]]) if copy.length < copy.width else corners[:2]
        width = min(copy.length, copy.width) or style.stop_line_width_m
        yield MapElement(name, ElementClass.STOP_LINE, line, width_m=width, style="solid", attributes=attributes)
        return
    # The box around an arrow is not its contour.
    is_shape = has_outline or kind in ("crosswalk", "parkingspace", "speedbump")
    yield MapElement(
        name,
        _AREAS[kind],
        _entrance_first(corners, road, copy) if kind == "parkingspace" else corners,
        closed=True,
        height_m=copy.height if kind == "speedbump" else 0.0,
        style="" if is_shape else VIRTUAL,
        shape=attributes["name"] if _AREAS[kind] == ElementClass.ROAD_MARK else "",
        attributes=attributes,
    )


def _marking_elements(
    road: Road, xml: Element, corners: np.ndarray, kind: str, name: str, attributes: dict[str, Any]
) -> Iterator[MapElement]:
    """Yields the strokes and bars of the <marking> elements of an object."""
    ids = [corner.get("id", str(i)) for i, corner in enumerate(_corner_records(xml))]
    if kind not in _PAINT or not len(corners):
        return
    # A last corner that repeats the first is not among the corners any more.
    rows = {corner: row % len(corners) for row, corner in enumerate(ids)}
    for index, marking in enumerate(xml.findall("markings/marking")):
        refs = [rows[r.get("id", "")] for r in marking.findall("cornerReference") if r.get("id", "") in rows]
        line = corners[refs] if len(refs) > 1 else _side(corners, marking.get("side", ""))
        line = without_repeats(line)
        width, bar, space, first, last = (
            max(number(marking, key, road.where, limit=1e4), 0.0)
            for key in ("width", "lineLength", "spaceLength", "startOffset", "stopOffset")
        )
        if len(line) < 2 or width == 0.0:
            continue
        values = {"width_m": width, "attributes": {**attributes, "marking": index}}
        for k, part in enumerate(_cut(line, bar, space, first, last, road.where)):
            style = "dashed" if space > 0.0 else "solid"
            yield MapElement(f"{name}_p{index}_{k}", _PAINT[kind], part, style=style, **values)


def _cut(line: np.ndarray, bar: float, space: float, first: float, last: float, where: str) -> Iterator[np.ndarray]:
    """Yields the parts of a line that are painted; the pattern runs on around corners."""
    along = polyline.arc_length(line)
    end = float(along[-1]) - last
    period = bar + space
    if bar <= 0.0 or space <= 0.0:
        starts, bar = np.array([first]), end - first
    else:
        if period < _SHORTEST_PERIOD_M or (end - first) / period > _MOST_BARS:
            raise SemlocError(f"{where}: a marking of {end:.0f} m repeats every {period:g} m; expected at least 5 cm")
        starts = np.arange(first, end - 1e-3, period)
    for start in starts:
        stop = min(start + bar, end)
        if stop - start > 1e-2:
            inside = line[(along > start) & (along < stop)]
            ends = polyline.interpolate(line, np.array([start, stop]))
            yield without_repeats(np.vstack([ends[:1], inside, ends[1:]]))


def _side(corners: np.ndarray, side: str) -> np.ndarray:
    """Returns one side of a box seen along the road: corners go counter-clockwise from rear right."""
    sides = {"right": (0, 1), "front": (1, 2), "left": (2, 3), "rear": (3, 0)}
    if len(corners) != 4 or side not in sides:
        return np.zeros((0, 3))
    return corners[list(sides[side])]


def _corner_records(xml: Element) -> list[Element]:
    outline = xml.find("outlines/outline")
    outline = xml.find("outline") if outline is None else outline
    return [] if outline is None else [c for c in outline if c.tag in ("cornerRoad", "cornerLocal")]


def _corners(road: Road, xml: Element, copy: _Copy) -> np.ndarray:
    """Returns the corners of the outline of an object, `[k 3]`; none where it has no outline."""
    s0, t0 = numbers(xml, "s t", road.where)
    is_repeated = xml.find("repeat") is not None
    heading = road.heading(copy.s) + copy.hdg
    center = road.locate(np.array([copy.s]), np.array([copy.t]), copy.z)[0]
    found = []
    for corner in _corner_records(xml):
        if corner.tag == "cornerRoad":
            s, t, dz = numbers(corner, "s t dz", road.where)
            s, t = (s + copy.s - s0, t + copy.t - t0) if is_repeated else (s, t)
            found.append(road.locate(np.array([s]), np.array([t]), dz)[0])
        else:
            u, v, z = numbers(corner, "u v z", road.where)
            c, sn = np.cos(heading), np.sin(heading)
            found.append(center + [u * c - v * sn, u * sn + v * c, z])
    points = np.array(found).reshape(-1, 3)
    return points[:-1] if len(points) > 3 and np.allclose(points[0], points[-1], atol=1e-6) else points


def _box(road: Road, copy: _Copy) -> np.ndarray:
    """Returns the corners of the box of an object, counter-clockwise from rear right, `[4 3]`; none without sizes."""
    if copy.length <= 0.0 and copy.width <= 0.0:
        return np.zeros((0, 3))
    center = road.locate(np.array([copy.s]), np.array([copy.t]), copy.z)[0]
    heading = road.heading(copy.s) + copy.hdg
    u = 0.5 * copy.length * np.array([-1.0, 1.0, 1.0, -1.0])
    v = 0.5 * copy.width * np.array([-1.0, -1.0, 1.0, 1.0])
    x, y = u * np.cos(heading) - v * np.sin(heading), u * np.sin(heading) + v * np.cos(heading)
    return center + np.stack([x, y, np.zeros(4)], axis=1)


def _entrance_first(corners: np.ndarray, road: Road, copy: _Copy) -> np.ndarray:
    """Returns the outline of a parking space so that its first side is the one nearest to the reference line."""
    base = road.locate(np.array([copy.s]), np.array([0.0]))[0]
    heading = road.heading(copy.s)
    across = np.abs((corners - base)[:, :2] @ np.array([-np.sin(heading), np.cos(heading)]))
    ring = as_ring(across[:, None])[:, 0]
    return np.roll(corners, -int(np.argmin(ring[:-1] + ring[1:])), axis=0)
