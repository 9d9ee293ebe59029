"""Maps written as Lanelet2 OSM XML (room: maps; host).

In: SemanticMap. Out: an .osm file of points, linestrings and polygons that other programs read; what Lanelet2 has no
words for goes to one tag of each way. Lanelets are not written: the map of what can be seen has no topology.
"""

from collections.abc import Iterator
from itertools import count
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import wgs84_from_enu
from semloc_jax.maps.elements import VIRTUAL, GeoOrigin, MapElement
from semloc_jax.maps.io import lanelet2_exact
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.storage import writing
from semloc_jax.structs import ElementClass

ORIGIN, NAME, FRAME = "semloc_origin", "semloc_name", "semloc_frame"
"""Attributes of the root element that bring the map back into its own frame."""
_THICK_M = 0.2
_OF_WAYS = frozenset({"traffic_light", "traffic_sign", "speed_limit"})
"""Regulatory elements that need no lanelet; of the others the tag of our own keeps which way had which part."""
_FIRST_WAY, _FIRST_RELATION = 1_000_000_000, 2_000_000_000
_TYPES = {
    ElementClass.STOP_LINE: "stop_line",
    ElementClass.CROSSWALK: "crosswalk_polygon",
    ElementClass.ROAD_MARK: "symbol",
    ElementClass.SLOT_LINE: "line_thin",
    ElementClass.PARKING_SLOT: "parking_space",
    ElementClass.SPEED_BUMP: "speed_bump",
    ElementClass.POLE: "pole",
    ElementClass.SIGN: "traffic_sign",
    ElementClass.TRAFFIC_LIGHT: "traffic_light",
    ElementClass.PILLAR: "wall",
    ElementClass.CONE: "traffic_cone",
    ElementClass.CURB: "curbstone",
    ElementClass.GUARDRAIL: "guard_rail",
}


def write_lanelet2(semantic_map: SemanticMap, path: str | Path) -> None:
    """Writes a map as Lanelet2: latitude and longitude where the map has an origin, else local_x and local_y.

    Traffic lights, signs and speed limits that name a way are written as regulatory elements.

    Raises:
        SemlocError: the file cannot be written, or an attribute has no form in JSON.
    """
    try:
        with writing(path) as partial, partial.open("w", encoding="utf-8") as stream:
            stream.writelines(_lines(semantic_map))
    except OSError as error:
        raise SemlocError(f"cannot write map {path}: {error.strerror}; give a path in a folder that exists") from error
    except (TypeError, ValueError) as error:
        raise SemlocError(f"cannot write map {path}: an attribute has no form in JSON ({error})") from error


def _lines(semantic_map: SemanticMap) -> Iterator[str]:
    origin = semantic_map.origin
    members = {NAME: semantic_map.name, FRAME: semantic_map.frame}
    members |= {ORIGIN: " ".join(repr(float(v)) for v in origin)} if origin is not None else {}
    yield '<?xml version="1.0" encoding="UTF-8"?>\n'
    yield f'<osm version="0.6" generator="semloc"{"".join(_attribute(*item) for item in members.items())}>\n'
    drawn = [_drawn(element) for element in semantic_map.elements]
    first = 1
    for element, points in zip(semantic_map.elements, drawn, strict=True):
        yield from _nodes(points, first, element.has_height, origin)
        first += len(points)
    first = 1
    for way, (element, points) in enumerate(zip(semantic_map.elements, drawn, strict=True), start=_FIRST_WAY):
        refs = [*range(first, first + len(points))]
        refs += refs[:1] if element.closed and np.array_equal(points, element.points) else []
        yield f'  <way id="{way}" version="1" visible="true">\n'
        yield from (f'    <nd ref="{ref}"/>\n' for ref in refs)
        yield from (_tag(key, value) for key, value in _tags(element, points).items())
        yield "  </way>\n"
        first += len(points)
    yield from _relations(semantic_map.elements)
    yield "</osm>\n"


def _nodes(points: np.ndarray, first: int, has_height: bool, origin: GeoOrigin | None) -> Iterator[str]:
    if origin is not None:
        lat, lon, alt = wgs84_from_enu(points, origin)
        places = [f'lat="{a:.11f}" lon="{o:.11f}"' for a, o in zip(lat, lon, strict=True)]
    else:
        places, alt = ['lat="" lon=""'] * len(points), points[:, 2]
    for index, place in enumerate(places):
        yield f'  <node id="{first + index}" version="1" visible="true" {place}>\n'
        if origin is None:
            yield _tag("local_x", f"{points[index, 0]:.6f}") + _tag("local_y", f"{points[index, 1]:.6f}")
        if has_height:
            yield _tag("ele", f"{alt[index]:.6f}")
        yield "  </node>\n"


def _drawn(element: MapElement) -> np.ndarray:
    """Returns the nodes of the way as other programs expect them: signs and lights by their lower edge."""
    points = element.points
    if element.label == ElementClass.SIGN and element.closed and len(points) >= 3:
        across = points[:, :2] - points[:, :2].mean(axis=0)
        direction = np.linalg.svd(across, full_matrices=False)[2][0]
        if element.normal is not None and direction @ [element.normal[1], -element.normal[0]] > 0.0:
            direction = -direction
        along = across @ direction
        ends = points[:, :2].mean(axis=0) + np.outer([along.min(), along.max()], direction)
        return np.column_stack([ends, np.full(2, points[:, 2].min())])
    if element.label == ElementClass.TRAFFIC_LIGHT and len(points) == 2 and element.width_m > 0.0:
        return points[0] + np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]) * element.width_m
    if element.label == ElementClass.PARKING_SLOT and len(points) == 4:
        return np.stack([points[:2].mean(axis=0), points[2:].mean(axis=0)])
    return points


def _tags(element: MapElement, drawn: np.ndarray) -> dict[str, str]:
    """Returns the tags of a way: those it once had, those Lanelet2 has for it, and the rest in one."""
    own = {k: v for k, v in element.attributes.items() if isinstance(v, str) and k in ("type", "subtype", "name")}
    tags = {"type": _type(element), **own}
    if "subtype" not in tags and element.label in (ElementClass.LANE_MARKING, ElementClass.SLOT_LINE):
        tags["subtype"] = element.style if element.style in ("solid", "dashed") else "solid"
    if element.label == ElementClass.PARKING_SLOT and len(element.points) == 4:
        tags["width"] = f"{np.linalg.norm(element.points[1] - element.points[0]):.3f}"
    elif element.width_m > 0.0:
        tags["width"] = f"{element.width_m:g}"
    height = element.height_m
    if element.label in (ElementClass.SIGN, ElementClass.TRAFFIC_LIGHT):
        height = float(np.ptp(element.points[:, 2]))
    tags |= {"height": f"{height:.3f}"} if height > 0.0 else {}
    tags |= {"radius": f"{element.radius_m:g}"} if element.radius_m > 0.0 else {}
    tags |= {"area": "yes"} if element.closed and drawn.shape == element.points.shape else {}
    return {key: value for key, value in tags.items() if value} | {
        lanelet2_exact.TAG: lanelet2_exact.to_tag(element, drawn)
    }


def _type(element: MapElement) -> str:
    if element.label != ElementClass.LANE_MARKING:
        return _TYPES[element.label]
    if element.style == VIRTUAL:
        return VIRTUAL
    return "line_thick" if element.width_m >= _THICK_M else "line_thin"


def _relations(elements: tuple[MapElement, ...]) -> Iterator[str]:
    """Yields the regulatory elements that the ways name, each with the ways that are there."""
    found: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for way, element in enumerate(elements, start=_FIRST_WAY):
        for entry in element.attributes.get("regulatory", []):
            subtype, _, rest = str(entry).partition(":")
            relation, _, role = rest.partition(":")
            if subtype in _OF_WAYS:
                found.setdefault((subtype, relation), []).append((way, role))
    numbers = count(_FIRST_RELATION)
    for (subtype, relation), members in found.items():
        number = relation if relation.isdigit() else str(next(numbers))
        yield f'  <relation id="{number}" version="1" visible="true">\n'
        yield from (f'    <member type="way" ref="{way}"{_attribute("role", role)}/>\n' for way, role in members)
        yield _tag("type", "regulatory_element") + (_tag("subtype", subtype) if subtype else "") + "  </relation>\n"


def _tag(key: str, value: str) -> str:
    return f"    <tag k={quoteattr(key)} v={quoteattr(_plain(value))}/>\n"


def _attribute(key: str, value: str) -> str:
    return f" {key}={quoteattr(_plain(value))}" if value else ""


def _plain(text: str) -> str:
    """Returns the text without characters that XML has no place for."""
    return "".join(c for c in text if c.isprintable() or c in "\n\t")
