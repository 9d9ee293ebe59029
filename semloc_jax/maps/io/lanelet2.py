"""Lanelet2 maps in OSM XML, Autoware's dialect included (room: maps; host).

In: a path. Out: SemanticMap of what can be seen: painted lines, curbs, signs, lights, poles.
Lanelet2 says which line is dashed, not where its bars are, and seldom how wide paint is: see `Lanelet2Style`.
"""

import logging
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import enu_from_wgs84
from semloc_jax.maps.elements import GeoOrigin, MapElement
from semloc_jax.maps.io import lanelet2_exact, lanelet2_writer
from semloc_jax.maps.io.lanelet2_ways import LOGICAL_TYPES, Lanelet2Style, elements_from_way
from semloc_jax.maps.io.osm import OsmFile, OsmItem, read_osm
from semloc_jax.maps.io.projector_info import LocalGrid, grid_beside, grid_of_mgrs
from semloc_jax.maps.semantic_map import SemanticMap

PLAIN_ROAD = "plain OpenStreetMap roads without markings"
_DRIVEN = frozenset({"road", "highway", "play_street", "bus_lane", "parking", "emergency_lane"})
"""Subtypes of lanelets that cars drive on."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Nodes:
    """Node positions in the map frame, and which of them came with a height."""

    row: dict[str, int]
    points: np.ndarray
    has_height: np.ndarray


@dataclass(frozen=True)
class _Frame:
    """The nodes, the place of their frame on the earth, and its name."""

    nodes: _Nodes
    origin: GeoOrigin | None
    name: str


def read_lanelet2(path: str | Path, origin: GeoOrigin | None = None, style: Lanelet2Style | None = None) -> SemanticMap:
    """Returns the map of a Lanelet2 OSM file.

    Nodes with `local_x`, `local_y` stay in that frame, or go to the ENU frame of `origin` where map_projector_info.yaml
    beside the map or the MGRS code of its nodes says where they lie. Else latitude and longitude go to the frame that
    the projector info names, or to the ENU frame of `origin`. Regulatory elements stay with the ways they refer to, as
    the attribute `regulatory`.

    Args:
        path: the .osm file.
        origin: place of the local frame; None takes that of the file, else the middle of the nodes.
        style: widths and dashes that the format leaves open.

    Raises:
        SemlocError: broken XML, missing nodes, or coordinates that are no numbers.
    """
    path = Path(path)
    osm = read_osm(path)
    frame = _locate(osm, path, origin)
    regulatory = _regulatory_references(osm)
    skipped: Counter[str] = Counter()
    elements: list[MapElement] = []
    for way_id, way in osm.ways.items():
        kind = way.tags.get("type", PLAIN_ROAD if "highway" in way.tags else "without type")
        rows = _rows(way_id, way, frame.nodes, path.name)
        points, has_height = frame.nodes.points[rows], bool(frame.nodes.has_height[rows].all())
        if lanelet2_exact.TAG in way.tags and len(rows):
            where = f"map {path.name}: way {way_id}"
            elements.append(lanelet2_exact.from_tag(way.tags[lanelet2_exact.TAG], points, has_height, where))
            continue
        tags = {**way.tags, **regulatory.get(way_id, {})}
        found = elements_from_way(way_id, tags, points, has_height, style or Lanelet2Style())
        elements += found
        if not found and kind not in LOGICAL_TYPES:
            skipped[kind] += 1
    if any(element.attributes.get("assumed") for element in elements):
        _log.info("map %s: widths and dashes are assumed where Lanelet2 does not state them", path.name)
    if skipped[PLAIN_ROAD]:
        _log.warning("map %s: %d %s", path.name, skipped[PLAIN_ROAD], PLAIN_ROAD)
    name = osm.attributes.get(lanelet2_writer.NAME, path.name)
    return SemanticMap(tuple(elements), frame.origin, name, {k: n for k, n in skipped.items() if n}, frame.name)


def lanelet_bounds(path: str | Path, origin: GeoOrigin | None = None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields the left and the right bound of each lanelet for vehicles, in its direction of travel, `[k 3]` [m].

    Args:
        path: the .osm file.
        origin: as for `read_lanelet2`; the bounds lie in the frame of its map.
    """
    path = Path(path)
    osm = read_osm(path)
    nodes = _locate(osm, path, origin).nodes
    for relation in osm.relations.values():
        tags = relation.tags
        if tags.get("type") != "lanelet" or tags.get("subtype", "road") not in _DRIVEN:
            continue
        ways = {role: ref for kind, ref, role in relation.references if kind == "way"}
        sides = [osm.ways.get(ways.get(role, "")) for role in ("left", "right")]
        if any(way is None or len(way.references) < 2 for way in sides):
            continue
        rows = [_rows(ways[role], way, nodes, path.name) for role, way in zip(("left", "right"), sides, strict=True)]
        yield _along_traffic(*(nodes.points[row] for row in rows))


def _along_traffic(left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns both bounds so that they run the same way and the left one lies to the left: ways run as they like."""
    same, opposite = (np.linalg.norm(left[[0, -1]] - right[ends], axis=1).sum() for ends in ([0, -1], [-1, 0]))
    right = right if same <= opposite else right[::-1]
    ring = np.vstack([right, left[::-1]])[:, :2]
    x, y = (ring - ring.mean(axis=0)).T
    is_left = float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) >= 0.0
    return (left, right) if is_left else (left[::-1], right[::-1])


def _locate(osm: OsmFile, path: Path, origin: GeoOrigin | None) -> _Frame:
    """Returns all nodes that ways use, in the map frame, and where that frame is."""
    used = dict.fromkeys(ref for way in osm.ways.values() for ref in way.references if ref in osm.nodes)
    items = [osm.nodes[ref] for ref in used]
    height = np.array([_coordinate(item, "ele", path.name) for item in items])
    local, geodetic = (
        np.array([[_coordinate(item, key, path.name) for key in keys] for item in items]).reshape(-1, 2)
        for keys in (("local_x", "local_y"), ("lat", "lon"))
    )
    rows = {ref: row for row, ref in enumerate(used)}
    has_height = np.isfinite(height)
    grid = grid_beside(path) or _grid_of_nodes(items)
    own = _own_origin(osm, path.name)
    name = osm.attributes.get(lanelet2_writer.FRAME, "")
    if len(items) == 0:
        return _Frame(_Nodes(rows, np.zeros((0, 3)), has_height), origin or own, name)
    if np.isfinite(local).all():
        points = np.column_stack([local, np.nan_to_num(height)])
        if origin is not None and grid is not None and grid.is_known:
            return _Frame(_flattened(rows, grid.to_enu(points, origin), has_height), origin, "")
        own = grid.origin if grid is not None else None
        name = name or (grid.name if grid is not None else "")
        return _Frame(_Nodes(rows, points, has_height), origin or own, name)
    if not np.isfinite(geodetic).all():
        lost = list(used)[int(np.argmin(np.isfinite(geodetic).all(axis=1)))]
        raise SemlocError(
            f"map {path.name}: node {lost} has neither lat, lon nor local_x, local_y like all others; add them"
        )
    lat, lon = geodetic.T
    if origin is None and own is None and grid is not None and grid.is_known:
        points = grid.from_geodetic(lat, lon, np.nan_to_num(height))
        return _Frame(_flattened(rows, points, has_height), grid.origin, grid.name)
    origin = origin or own or _middle(geodetic, height)
    points = enu_from_wgs84(lat, lon, np.where(has_height, height, origin.alt_m), origin)
    return _Frame(_flattened(rows, points, has_height), origin, name)


def _flattened(rows: dict[str, int], points: np.ndarray, has_height: np.ndarray) -> _Nodes:
    """Returns the nodes with height 0 where none was given."""
    return _Nodes(rows, np.column_stack([points[:, :2], np.where(has_height, points[:, 2], 0.0)]), has_height)


def _middle(geodetic: np.ndarray, height: np.ndarray) -> GeoOrigin:
    middle = 0.5 * (geodetic.min(axis=0) + geodetic.max(axis=0))
    alt_m = float(np.median(height[np.isfinite(height)])) if np.isfinite(height).mean() > 0.5 else 0.0
    return GeoOrigin(round(float(middle[0]), 5), round(float(middle[1]), 5), round(alt_m, 1))


def _grid_of_nodes(items: list[OsmItem]) -> LocalGrid | None:
    """Returns the MGRS square that all nodes name, if they do."""
    squares = {item.tags.get("mgrs_code", "")[:5] for item in items}
    if len(squares) != 1 or "" in squares:
        return None
    try:
        return grid_of_mgrs(squares.pop())
    except SemlocError:
        return None


def _own_origin(osm: OsmFile, name: str) -> GeoOrigin | None:
    """Returns the origin that `write_lanelet2` left in the root element."""
    text = osm.attributes.get(lanelet2_writer.ORIGIN)
    if text is None:
        return None
    try:
        lat, lon, alt = (float(word) for word in text.split())
    except ValueError:
        lat = float("nan")
    if not (abs(lat) <= 90.0 and abs(lon) <= 180.0 and abs(alt) < 1e5):
        raise SemlocError(f"map {name}: {lanelet2_writer.ORIGIN} = '{text[:60]}'; expected latitude, longitude, height")
    return GeoOrigin(lat, lon, alt)


def _coordinate(item: OsmItem, key: str, name: str) -> float:
    """Returns a coordinate of a node from its tags or attributes; NaN where it is absent or empty."""
    text = item.tags.get(key, item.attributes.get(key, "")).strip()
    if not text:
        return float("nan")
    try:
        value = float(text)
    except ValueError:
        value = float("inf")
    if not abs(value) < 1e8:
        raise SemlocError(f"map {name}: node {item.attributes['id']} has {key} = '{text}'; expected metres or degrees")
    return value


def _rows(way_id: str, way: OsmItem, nodes: _Nodes, name: str) -> np.ndarray:
    lost = [ref for ref in way.references if ref not in nodes.row]
    if lost:
        raise SemlocError(
            f"map {name}: way {way_id} refers to node {lost[0]}, which is not in the file; is it complete?"
        )
    return np.array([nodes.row[ref] for ref in way.references], dtype=np.int64)


def _regulatory_references(osm: OsmFile) -> dict[str, dict[str, list[str]]]:
    """Returns for each way the regulatory elements that name it, as `subtype:id:role`."""
    found: dict[str, dict[str, list[str]]] = {}
    for relation_id, relation in osm.relations.items():
        if relation.tags.get("type") != "regulatory_element":
            continue
        for kind, ref, role in relation.references:
            if kind == "way":
                entry = f"{relation.tags.get('subtype', '')}:{relation_id}:{role}"
                found.setdefault(ref, {}).setdefault("regulatory", []).append(entry)
    return found
