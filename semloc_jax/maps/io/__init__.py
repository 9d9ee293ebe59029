"""Readers and writers of vector maps (room: maps; host).

In: a path. Out: SemanticMap, whatever the format.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io.argoverse2 import Argoverse2Style, find_archive, is_argoverse2, map_from_argoverse2
from semloc_jax.maps.io.drive_geojson import map_from_drive_geojson, write_drive_geojson
from semloc_jax.maps.io.geojson import map_from_geojson, write_geojson
from semloc_jax.maps.io.geopackage import StoredMap, read_geopackage, write_geopackage
from semloc_jax.maps.io.lanelet2 import read_lanelet2
from semloc_jax.maps.io.lanelet2_ways import Lanelet2Style
from semloc_jax.maps.io.lanelet2_writer import write_lanelet2
from semloc_jax.maps.io.opendrive import OpenDriveStyle, read_opendrive
from semloc_jax.maps.semantic_map import SemanticMap

__all__ = [
    "Argoverse2Style",
    "Lanelet2Style",
    "OpenDriveStyle",
    "StoredMap",
    "read_geopackage",
    "read_lanelet2",
    "read_map",
    "read_opendrive",
    "write_drive_geojson",
    "write_geojson",
    "write_geopackage",
    "write_lanelet2",
]


def read_map(path: str | Path, origin: GeoOrigin | None = None) -> SemanticMap:
    """Returns the map in a file of any known format: drive layout, RFC 7946 GeoJSON, Lanelet2 OSM.

    Args:
        path: .osm is Lanelet2; .geojson and .json are the drive layout if they have the member `frame`, else RFC 7946.
        origin: where to put the local frame of a map in latitude and longitude; None lets the reader choose.

    Raises:
        SemlocError: no such file, no known format, broken content, or nothing in it that can be seen.
    """
    path = Path(path)
    if path.is_dir():
        path = find_archive(path) or path
    if not path.is_file():
        raise SemlocError(f"map {path}: no such file; give a .geojson, .json or .osm map")
    if path.suffix.lower() in (".osm", ".xml"):
        found = read_lanelet2(path, origin)
    elif path.suffix.lower() == ".gpkg":
        found = read_geopackage(path)
    elif path.suffix.lower() == ".xodr":
        found = read_opendrive(path, origin)
    elif path.suffix.lower() in (".geojson", ".json"):
        found = _map_from_json(_parse_json(path), path.name, origin)
    else:
        raise SemlocError(f"map {path.name}: unknown type '{path.suffix}'; expected .geojson, .json or .osm")
    if not found.is_visible:
        unknown = ", ".join(f"{count} {name}" for name, count in sorted(found.skipped.items()))
        raise SemlocError(
            f"map {path.name}: no element that a camera could see (left out: {unknown or 'nothing'}); "
            "expected markings, poles or signs with a known `class`"
        )
    return found


def _map_from_json(document: Any, name: str, origin: GeoOrigin | None) -> SemanticMap:
    """Returns the map in a parsed JSON document: Argoverse 2, the drive layout, or GeoJSON in degrees."""
    if is_argoverse2(document):
        return map_from_argoverse2(document, name, origin)
    if not isinstance(document, dict) or not isinstance(document.get("features"), list):
        kind = document.get("type") if isinstance(document, dict) else type(document).__name__
        raise SemlocError(f"map {name}: holds {kind}; expected a GeoJSON FeatureCollection with `features`")
    if isinstance(document.get("frame"), Mapping):
        return map_from_drive_geojson(document, name)
    return map_from_geojson(document, name, origin)


def _parse_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SemlocError(f"map {path.name}: not valid JSON ({error}); is the file complete?") from error
