"""Lanelet2 maps in OSM XML, Autoware's dialect included (room: maps; host).

In: a path. Out: SemanticMap of what can be seen: painted lines, curbs, signs, lights, poles.
Lanelet2 says which line is dashed, not where its bars are, and seldom how wide paint is: see `Lanelet2Style`.
"""

import logging
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import enu_from_wgs84
from semloc_jax.maps.elements import GeoOrigin, MapElement
from semloc_jax.maps.io.lanelet2_ways import LOGICAL_TYPES, Lanelet2Style, elements_from_way
from semloc_jax.maps.io.osm import OsmFile, OsmItem, read_osm
from semloc_jax.maps.semantic_map import SemanticMap

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Nodes:
    """Node positions in the map frame, and which of them came with a height."""

    row: dict[str, int]
    points: np.ndarray
    has_height: np.ndarray


def read_lanelet2(path: str | Path, origin: GeoOrigin | None = None, style: Lanelet2Style | None = None) -> SemanticMap:
    """Returns the map of a Lanelet2 OSM file.

    Nodes with `local_x`, `local_y` stay in that frame; else latitude and longitude go to the ENU frame of `origin`.
    Regulatory elements stay with the ways they refer to, as the attribute `regulatory`.

    Args:
        path: the .osm file.
        origin: place of the local frame; None takes the middle of the nodes. Not for maps with local coordinates.
        style: widths and dashes that the format leaves open.

    Raises:
        SemlocError: broken XML, missing nodes, or coordinates that are no numbers.
    """
    path = Path(path)
    osm = read_osm(path)
    nodes, origin = _locate(osm, path.name, origin)
    regulatory = _regulatory_references(osm)
    skipped: Counter[str] = Counter()
    elements: list[MapElement] = []
    for way_id, way in osm.ways.items():
        kind = way.tags.get("type", "without type")
        rows = _rows(way_id, way, nodes, path.name)
        found = elements_from_way(
            way_id,
            {**way.tags, **regulatory.get(way_id, {})},
            nodes.points[rows],
            bool(nodes.has_height[rows].all()),
            style or Lanelet2Style(),
        )
        elements += found
        if not found and kind not in LOGICAL_TYPES:
            skipped[kind] += 1
    if any(element.attributes.get("assumed") for element in elements):
        _log.info("map %s: widths and dashes are assumed where Lanelet2 does not state them", path.name)
    return SemanticMap(tuple(elements), origin, path.name, dict(skipped))


def _locate(osm: OsmFile, name: str, origin: GeoOrigin | None) -> tuple[_Nodes, GeoOrigin | None]:
    """Returns all nodes that ways use, in the map frame, and where that frame is."""
    used = dict.fromkeys(ref for way in osm.ways.values() for ref in way.references if ref in osm.nodes)
    items = [osm.nodes[ref] for ref in used]
    height = np.array([_coordinate(item, "ele", name) for item in items])
    local = np.array([[_coordinate(item, key, name) for key in ("local_x", "local_y")] for item in items]).reshape(
        -1, 2
    )
    geodetic = np.array([[_coordinate(item, key, name) for key in ("lat", "lon")] for item in items]).reshape(-1, 2)
    rows = {ref: row for row, ref in enumerate(used)}
    flat = np.nan_to_num(height)
    if len(items) == 0:
        return _Nodes(rows, np.zeros((0, 3)), np.zeros(0, dtype=bool)), origin
    if np.isfinite(local).all():
        return _Nodes(rows, np.column_stack([local, flat]), np.isfinite(height)), origin
    if not np.isfinite(geodetic).all():
        lost = list(used)[int(np.argmin(np.isfinite(geodetic).all(axis=1)))]
        raise SemlocError(
            f"map {name}: node {lost} has neither lat, lon nor local_x, local_y like all others; add the coordinates"
        )
    if origin is None:
        middle = 0.5 * (geodetic.min(axis=0) + geodetic.max(axis=0))
        alt_m = float(np.median(height[np.isfinite(height)])) if np.isfinite(height).mean() > 0.5 else 0.0
        origin = GeoOrigin(round(float(middle[0]), 5), round(float(middle[1]), 5), round(alt_m, 1))
    points = enu_from_wgs84(geodetic[:, 0], geodetic[:, 1], np.where(np.isfinite(height), height, origin.alt_m), origin)
    points[~np.isfinite(height), 2] = 0.0
    return _Nodes(rows, points, np.isfinite(height)), origin


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
