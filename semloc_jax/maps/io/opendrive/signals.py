"""Signals of an OpenDRIVE road: plates of signs, heads of lights, stop lines, painted symbols (room: maps; host).

In: the <signal> elements of a Road. Out: map elements. A signal of orientation "+" is for traffic along s and faces
against it. Types are those of the German catalogue, which most files use; other countries' plates are rectangles.
"""

from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from semloc_jax.maps.elements import VIRTUAL, MapElement
from semloc_jax.maps.io.opendrive.marks import OpenDriveStyle
from semloc_jax.maps.io.opendrive.road import Road
from semloc_jax.maps.io.xml_stream import number, numbers
from semloc_jax.structs import ElementClass

_FLAT_M = 0.1
"""What is not higher than this lies on the road."""
_STOP_LINES = frozenset({"294", "341"})
_CROSSINGS = frozenset({"293", "1000003", "1000004"})
_LIGHTS = frozenset(str(number) for number in (*range(1000001, 1000003), *range(1000007, 1000021)))
_GERMAN = frozenset({"", "opendrive", "de", "deu", "germany", "276"})
_GERMAN_SHAPES = {"206": "octagon", "205": "triangle_down", "306": "diamond", "307": "diamond", "301": "triangle"}
_NUM_CIRCLE_POINTS = 16


def signal_elements(road: Road, style: OpenDriveStyle) -> Iterator[MapElement]:
    """Yields the visible signals of a road; those without a size are kept as logical ones."""
    for xml in road.xml.findall("signals/signal"):
        s, t, z, turn = numbers(xml, "s t zOffset hOffset", road.where)
        width, height = (max(number(xml, key, road.where, limit=1e3), 0.0) for key in ("width", "height"))
        against = xml.get("orientation", "none") == "-"
        name = f"r{road.id}_g{xml.get('id', '')}_{len(xml.get('name', ''))}_{s:.2f}"
        attributes = {key: xml.get(key, "") for key in ("type", "subtype", "country", "name") if xml.get(key)}
        attributes |= {"orientation": xml.get("orientation", "none")}
        kind = xml.get("type", "")
        heading = road.heading(s) + turn + (np.pi if against else 0.0)
        center = road.locate(np.array([s]), np.array([t]), z)[0]
        is_flat = height <= _FLAT_M and z < _FLAT_M and width > 0.0
        if kind in _STOP_LINES and is_flat:
            yield _stop_line(road, s, t, width, against, name, attributes, style)
        elif is_flat:
            label = ElementClass.CROSSWALK if kind in _CROSSINGS else ElementClass.ROAD_MARK
            yield _symbol(center, heading, width, _painted_length(xml, label, road.where), label, name, attributes)
        elif kind in _LIGHTS or (xml.get("dynamic") == "yes" and kind in ("-1", "")):
            yield from _light(center, width, height, name, attributes, style)
        else:
            yield _plate(center, heading, width, height, kind, name, attributes)


def _plate(
    lower: np.ndarray, heading: float, width: float, height: float, kind: str, name: str, attributes: dict[str, Any]
) -> MapElement:
    """Returns the plate of a sign above the middle of its lower edge; logical where it has no size."""
    width, height = width or height, height or width
    shape = _shape(kind, attributes.get("country", ""))
    outline = _OUTLINES[shape]
    across = np.array([-np.sin(heading), np.cos(heading), 0.0])
    points = lower + outline[:, :1] * (0.5 * (width or 1.0)) * across
    points[:, 2] += 0.5 * (outline[:, 1] + 1.0) * (height or 1.0)
    normal = np.array([-np.cos(heading), -np.sin(heading), 0.0])
    return MapElement(
        name,
        ElementClass.SIGN,
        points,
        closed=True,
        style="" if width > 0.0 else VIRTUAL,
        shape=shape,
        normal=normal,
        attributes=attributes,
    )


def _light(
    base: np.ndarray, width: float, height: float, name: str, attributes: dict[str, Any], style: OpenDriveStyle
) -> Iterator[MapElement]:
    """Yields the head of a traffic light, and the pole below where the file gives both as one tall thing."""
    top = base + [0.0, 0.0, height or 1.0]
    foot = base
    if height > style.tallest_head_m and width > 0.0:
        attributes = {**attributes, "assumed": ["head"]}
        foot = top - [0.0, 0.0, min(style.head_ratio * width, 0.5 * height)]
        told = {**attributes, "assumed": ["head", "radius"]}
        sizes = {"radius_m": style.pole_radius_m, "radius_top_m": style.pole_radius_m}
        yield MapElement(f"{name}_pole", ElementClass.POLE, np.stack([base, foot]), attributes=told, **sizes)
    kept = "" if width > 0.0 and height > 0.0 else VIRTUAL
    yield MapElement(
        name, ElementClass.TRAFFIC_LIGHT, np.stack([foot, top]), width_m=width, style=kept, attributes=attributes
    )


def _stop_line(
    road: Road,
    s: float,
    t: float,
    width: float,
    against: bool,
    name: str,
    attributes: dict[str, Any],
    style: OpenDriveStyle,
) -> MapElement:
    """Returns a stop line over the lanes of its traffic: from the middle of the road outwards, or about its place."""
    side = -1.0 if road.drives_right != against else 1.0
    first = t if abs(t) < 0.25 * width else t - 0.5 * side * width
    points = road.locate(np.array([s, s]), np.array([first, first + side * width]))
    told = {**attributes, "assumed": ["width", "extent"]}
    return MapElement(
        name, ElementClass.STOP_LINE, points, width_m=style.stop_line_width_m, style="solid", attributes=told
    )


def _symbol(
    center: np.ndarray,
    heading: float,
    width: float,
    length: float,
    label: ElementClass,
    name: str,
    attributes: dict[str, Any],
) -> MapElement:
    """Returns the place of something painted whose shape the file does not tell, as a logical box."""
    u = 0.5 * length * np.array([-1.0, 1.0, 1.0, -1.0])
    v = 0.5 * width * np.array([-1.0, -1.0, 1.0, 1.0])
    c, s = np.cos(heading), np.sin(heading)
    points = center + np.stack([u * c - v * s, u * s + v * c, np.zeros(4)], axis=1)
    shape = attributes.get("name", "") if label == ElementClass.ROAD_MARK else ""
    return MapElement(name, label, points, closed=True, style=VIRTUAL, shape=shape, attributes=attributes)


def _painted_length(xml: Element, label: ElementClass, where: str) -> float:
    usual = 4.0 if label == ElementClass.CROSSWALK else 5.0
    value = number(xml, "value", where, usual, 1e6)
    return value if 0.5 < value < 20.0 else usual


def _shape(kind: str, country: str) -> str:
    """Returns the shape of the plate of a type of the German catalogue (StVO); else a rectangle."""
    if country.lower() not in _GERMAN or not kind.isdigit():
        return "rectangle"
    code = int(kind)
    if kind in _GERMAN_SHAPES:
        return _GERMAN_SHAPES[kind]
    if 101 <= code <= 151:
        return "triangle"
    return "circle" if 209 <= code <= 282 else "rectangle"


def _regular(num_points: int, turn_rad: float) -> np.ndarray:
    angle = 2.0 * np.pi * np.arange(num_points) / num_points + turn_rad
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return points / np.abs(points).max(axis=0)


_OUTLINES = {
    "rectangle": np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]),
    "triangle": np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]]),
    "triangle_down": np.array([[0.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]),
    "diamond": np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]),
    "octagon": _regular(8, np.pi / 8.0),
    "circle": _regular(_NUM_CIRCLE_POINTS, 0.0),
}
"""Outlines from -1 to 1: across to the left of the heading, and up."""
