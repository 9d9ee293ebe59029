"""Readers and writers of vector maps (room: maps; host).

In: a path. Out: SemanticMap, whatever the format.
"""

from collections.abc import Mapping
from pathlib import Path

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io import apollo
from semloc_jax.maps.io.apollo import ApolloStyle, read_apollo
from semloc_jax.maps.io.argoverse2 import Argoverse2Style, find_archive, is_argoverse2, map_from_argoverse2
from semloc_jax.maps.io.compact import read_compact, write_compact
from semloc_jax.maps.io.drive_geojson import map_from_drive_geojson, write_drive_geojson
from semloc_jax.maps.io.geojson import map_from_geojson, write_geojson
from semloc_jax.maps.io.geopackage import StoredMap, read_geopackage, write_geopackage
from semloc_jax.maps.io.json_stream import JsonFile, JsonList
from semloc_jax.maps.io.lanelet2 import read_lanelet2
from semloc_jax.maps.io.lanelet2_ways import Lanelet2Style
from semloc_jax.maps.io.lanelet2_writer import write_lanelet2
from semloc_jax.maps.io.lanes import read_lane_centers
from semloc_jax.maps.io.left_out import left_out
from semloc_jax.maps.io.ngii import NgiiStyle, is_ngii, read_ngii
from semloc_jax.maps.io.nuscenes import NuScenesStyle, is_nuscenes, map_from_nuscenes
from semloc_jax.maps.io.opendrive import OpenDriveStyle, read_opendrive
from semloc_jax.maps.semantic_map import SemanticMap

__all__ = [
    "ApolloStyle",
    "Argoverse2Style",
    "Lanelet2Style",
    "NgiiStyle",
    "NuScenesStyle",
    "OpenDriveStyle",
    "StoredMap",
    "WRITTEN_SUFFIXES",
    "left_out",
    "read_apollo",
    "read_compact",
    "read_geopackage",
    "read_lane_centers",
    "read_lanelet2",
    "read_map",
    "read_ngii",
    "read_opendrive",
    "write_compact",
    "write_drive_geojson",
    "write_geojson",
    "write_geopackage",
    "write_lanelet2",
    "write_map",
]

_HEAD_BYTES = 4096
_READ_SUFFIXES = (".geojson", ".json", ".osm", ".xodr", ".gpkg", ".smap", ".txt")


def read_map(path: str | Path, origin: GeoOrigin | None = None) -> SemanticMap:
    """Returns the map in a file of any known format.

    Args:
        path: .osm is Lanelet2, .xodr OpenDRIVE, .gpkg GeoPackage, .smap the compact form, .txt an Apollo HD map;
            .geojson and .json are an Argoverse 2 archive, a nuScenes map expansion, the drive layout if they have the
            member `frame`, else RFC 7946; a folder is that of an Argoverse 2 log, of NGII shapefiles or of a drive.
        origin: where to put the local frame of a map in latitude and longitude; None lets the reader choose.

    Raises:
        SemlocError: no such file, no known format, broken content, or nothing in it that can be seen.
    """
    path = _map_in(Path(path))
    is_shapefiles = is_ngii(path)
    if path.is_dir() and not is_shapefiles:
        raise SemlocError(
            f"map {path}: a folder without a map; expected that of an Argoverse 2 log, of NGII shapefiles or of a "
            "drive with map.geojson, or give the map file itself"
        )
    if not path.is_file() and not is_shapefiles:
        raise SemlocError(f"map {path}: no such file; give a {', '.join(_READ_SUFFIXES)} map")
    if is_shapefiles:
        found = read_ngii(path, origin)
    elif path.suffix.lower() in (".osm", ".xml"):
        found = read_lanelet2(path, origin)
    elif path.suffix.lower() == ".gpkg":
        found = read_geopackage(path)
    elif path.suffix.lower() == ".smap":
        found = read_compact(path)
    elif path.suffix.lower() == ".xodr":
        found = read_opendrive(path, origin)
    elif path.suffix.lower() in apollo.SUFFIXES:
        found = read_apollo(path, origin)
    elif path.suffix.lower() in (".geojson", ".json"):
        found = _map_from_json(path, origin)
    else:
        raise SemlocError(f"map {path.name}: unknown type '{path.suffix}'; expected {', '.join(_READ_SUFFIXES)}")
    if not found.is_visible:
        unknown = ", ".join(f"{count} {name}" for name, count in sorted(found.skipped.items()))
        raise SemlocError(
            f"map {path.name}: no element that a camera could see (left out: {unknown or 'nothing'}); "
            "expected markings, poles or signs with a known `class`"
        )
    return found


def _map_in(path: Path) -> Path:
    """Returns the file of the map where a folder holds one, else what was given."""
    if not path.is_dir():
        return path
    drive = path / "map.geojson"
    return find_archive(path) or (drive if drive.is_file() else path)


WRITTEN_SUFFIXES = (".geojson", ".gpkg", ".osm", ".smap")


def write_map(semantic_map: SemanticMap, path: str | Path, in_degrees: bool | None = None) -> None:
    """Writes a map in the format of its suffix: GeoJSON, GeoPackage, Lanelet2 or the compact form.

    Args:
        semantic_map: the map.
        path: ends in .geojson, .gpkg, .osm or .smap.
        in_degrees: GeoJSON after RFC 7946, else the drive layout in metres; None takes degrees where the map has a
            place on the earth.

    Raises:
        SemlocError: another suffix, or the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix in (".geojson", ".json"):
        is_geodetic = semantic_map.origin is not None if in_degrees is None else in_degrees
        (write_geojson if is_geodetic else write_drive_geojson)(semantic_map, path)
    elif suffix in _WRITERS:
        _WRITERS[suffix](semantic_map, path)
    else:
        raise SemlocError(f"map {path}: cannot write '{suffix}'; expected {', '.join(WRITTEN_SUFFIXES)}")


_WRITERS = {".gpkg": write_geopackage, ".osm": write_lanelet2, ".smap": write_compact}


def _map_from_json(path: Path, origin: GeoOrigin | None) -> SemanticMap:
    """Returns the map in a JSON file, read item by item: Argoverse 2, nuScenes, the drive layout, or GeoJSON."""
    with path.open("rb") as stream:
        is_list = stream.read(_HEAD_BYTES).lstrip().startswith(b"[")
    if is_list:
        raise SemlocError(f"map {path.name}: holds list; expected a GeoJSON FeatureCollection with `features`")
    document = JsonFile(path)
    if is_argoverse2(document):
        return map_from_argoverse2(document, path.name, origin)
    if is_nuscenes(document):
        return map_from_nuscenes(document, path.name)
    if not isinstance(document.get("features"), JsonList):
        kind = str(document.get("type"))[:40]
        raise SemlocError(f"map {path.name}: holds {kind}; expected a GeoJSON FeatureCollection with `features`")
    members = {key: document[key] if key == "features" else document.whole(key) for key in document}
    if isinstance(members.get("frame"), Mapping):
        return map_from_drive_geojson(members, path.name)
    return map_from_geojson(members, path.name, origin)
