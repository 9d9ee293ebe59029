"""The table of map formats: which file is read by what and written by what (room: maps; host).

In: a path. Out: SemanticMap, whatever the format; a map file. A new format is one module and one row of a table here.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io import apollo
from semloc_jax.maps.io.argoverse2 import find_archive, is_argoverse2, map_from_argoverse2
from semloc_jax.maps.io.compact import read_compact, write_compact
from semloc_jax.maps.io.drive_geojson import map_from_drive_geojson, write_drive_geojson
from semloc_jax.maps.io.geojson import map_from_geojson, write_geojson
from semloc_jax.maps.io.geopackage import StoredMap, read_geopackage, write_geopackage
from semloc_jax.maps.io.json_stream import JsonFile, JsonList
from semloc_jax.maps.io.lanelet2 import read_lanelet2
from semloc_jax.maps.io.lanelet2_writer import write_lanelet2
from semloc_jax.maps.io.ngii import is_ngii, read_ngii
from semloc_jax.maps.io.nuscenes import is_nuscenes, map_from_nuscenes
from semloc_jax.maps.io.opendrive import read_opendrive
from semloc_jax.maps.io.packed_drive import read_packed_map
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.maps.soundness import sound
from semloc_jax.storage import rare_collection, reading

_HEAD_BYTES = 4096

Reader = Callable[[Path, GeoOrigin | None], SemanticMap]
Writer = Callable[[SemanticMap, Path], None]
JsonReader = Callable[[Mapping[str, Any], str, GeoOrigin | None], SemanticMap]


class MapFormat(NamedTuple):
    """A format that is recognised by its suffix.

    Args:
        suffixes: the suffixes of its files, in lower case.
        read: takes the path and the origin of the local frame (None: the reader chooses).
        write: takes the map and the path; None where the format is only read.
    """

    suffixes: tuple[str, ...]
    read: Reader
    write: Writer | None = None


class JsonFormat(NamedTuple):
    """A format of JSON files that is recognised by the content.

    Args:
        recognises: whether a document is of this format.
        read: takes the document, the name of the file and the origin of the local frame.
    """

    recognises: Callable[[Mapping[str, Any]], bool]
    read: JsonReader


def _read_json(path: Path, origin: GeoOrigin | None) -> SemanticMap:
    """The map in a JSON file, read item by item."""
    with path.open("rb") as stream:
        is_list = stream.read(_HEAD_BYTES).lstrip().startswith(b"[")
    if is_list:
        raise SemlocError(f"map {path.name}: holds list; expected a GeoJSON FeatureCollection with `features`")
    document = JsonFile(path)
    for kind in JSON_FORMATS:
        if kind.recognises(document):
            return kind.read(document, path.name, origin)
    kind_text = str(document.get("type"))[:40]
    raise SemlocError(f"map {path.name}: holds {kind_text}; expected a GeoJSON FeatureCollection with `features`")


def _has_features(document: Mapping[str, Any]) -> bool:
    return isinstance(document.get("features"), JsonList)


def _map_from_features(document: JsonFile, name: str, origin: GeoOrigin | None) -> SemanticMap:
    """The map of a FeatureCollection: the drive layout where it has the member `frame`, else RFC 7946."""
    members = {key: document[key] if key == "features" else document.whole(key) for key in document}
    if isinstance(members.get("frame"), Mapping):
        return map_from_drive_geojson(members, name)
    return map_from_geojson(members, name, origin)


def _write_geojson(semantic_map: SemanticMap, path: Path) -> None:
    """GeoJSON in degrees where the map has a place on the earth, else in metres."""
    (write_drive_geojson if semantic_map.origin is None else write_geojson)(semantic_map, path)


FORMATS = {
    "GeoJSON": MapFormat((".geojson", ".json"), _read_json, _write_geojson),
    "GeoPackage": MapFormat((".gpkg",), lambda path, _: read_geopackage(path), write_geopackage),
    "Lanelet2": MapFormat((".osm", ".xml"), read_lanelet2, write_lanelet2),
    "OpenDRIVE": MapFormat((".xodr",), read_opendrive),
    "compact": MapFormat((".smap",), lambda path, _: read_compact(path), write_compact),
    "packed drive": MapFormat((".slocal",), lambda path, _: read_packed_map(path)),
    "Apollo": MapFormat(tuple(apollo.SUFFIXES), apollo.read_apollo),
}
"""Formats by name; the suffixes of a row belong to it alone, the first is the one that is written. Of several maps
beside a recording that of the first row is taken."""

JSON_FORMATS = (
    JsonFormat(is_argoverse2, map_from_argoverse2),
    JsonFormat(is_nuscenes, lambda document, name, _: map_from_nuscenes(document, name)),
    JsonFormat(_has_features, _map_from_features),
)
"""Formats of JSON files; the first that recognises the document reads it."""

READ_SUFFIXES = tuple(suffix for row in FORMATS.values() for suffix in row.suffixes)
MAP_SUFFIXES = tuple(suffix for suffix in READ_SUFFIXES if suffix not in (".json", ".xml", ".txt"))
"""Suffixes of files that hold nothing but maps."""
WRITTEN_SUFFIXES = tuple(row.suffixes[0] for row in FORMATS.values() if row.write)


def format_of(path: Path) -> MapFormat | None:
    """The row of a file by its suffix; None where there is none."""
    return next((row for row in FORMATS.values() if path.suffix.lower() in row.suffixes), None)


def read_map(path: str | Path, origin: GeoOrigin | None = None) -> SemanticMap:
    """Returns the map in a file of any known format.

    Args:
        path: .osm is Lanelet2, .xodr OpenDRIVE, .gpkg GeoPackage, .smap the compact form, .slocal a packed drive,
            .txt an Apollo HD map;
            .geojson and .json are an Argoverse 2 archive, a nuScenes map expansion, the drive layout if they have the
            member `frame`, else RFC 7946; a folder is that of an Argoverse 2 log, of NGII shapefiles or of a drive.
        origin: where to put the local frame of a map in latitude and longitude; None lets the reader choose.

    Raises:
        SemlocError: no such file, no known format, broken content, or nothing in it that can be seen.

    >>> semantic_map = sj.read_map(folder / "map.geojson")
    >>> semantic_map.num_elements > 20, sj.ElementClass.LANE_MARKING in semantic_map.labels
    (True, True)
    """
    path = _map_in(Path(path))
    read = _reader(path)
    with rare_collection():
        with reading(f"map {path.name}"):
            found = read(path, origin)
        if not isinstance(found, StoredMap):  # which looks at its elements when it reads them
            found = sound(found)
    if not found.is_visible:
        unknown = ", ".join(f"{count} {name}" for name, count in sorted(found.skipped.items()))
        unknown = "; ".join(filter(None, [unknown, *list(found.faulty.values())[:1]]))
        raise SemlocError(
            f"map {path.name}: no element that a camera could see (left out: {unknown or 'nothing'}); "
            "expected markings, poles or signs with a known `class`"
        )
    return found


def _map_in(path: Path) -> Path:
    """The file of the map where a folder holds one, else what was given."""
    if not path.is_dir():
        return path
    drive = path / "map.geojson"
    return find_archive(path) or (drive if drive.is_file() else path)


def _reader(path: Path) -> Reader:
    """What reads the file or folder."""
    if is_ngii(path):
        return read_ngii
    if path.is_dir():
        raise SemlocError(
            f"map {path}: a folder without a map; expected that of an Argoverse 2 log, of NGII shapefiles or of a "
            "drive with map.geojson, or give the map file itself"
        )
    if not path.is_file():
        known = path.suffix.lower() in READ_SUFFIXES
        raise SemlocError(f"map {path}: no such file" + ("" if known else f"; give a {', '.join(READ_SUFFIXES)} map"))
    row = format_of(path)
    if row is not None:
        return row.read
    raise SemlocError(f"map {path.name}: unknown type '{path.suffix}'; expected {', '.join(READ_SUFFIXES)}")


def write_map(semantic_map: SemanticMap, path: str | Path, in_degrees: bool | None = None) -> None:
    """Writes a map in the format of its suffix: GeoJSON, GeoPackage, Lanelet2 or the compact form.

    Args:
        semantic_map: the map.
        path: ends in .geojson, .gpkg, .osm or .smap.
        in_degrees: GeoJSON after RFC 7946, else the drive layout in metres; None takes degrees where the map has a
            place on the earth.

    Raises:
        SemlocError: another suffix, or the file cannot be written.

    >>> sj.write_map(street, tmp / "street.osm")
    >>> sj.read_map(tmp / "street.osm").num_elements
    3
    """
    path = Path(path)
    row = format_of(path)
    write = None if row is None else row.write
    if write is None:
        raise SemlocError(f"map {path}: cannot write '{path.suffix.lower()}'; expected {', '.join(WRITTEN_SUFFIXES)}")
    if write is _write_geojson and in_degrees is not None:
        write = write_geojson if in_degrees else write_drive_geojson
    write(semantic_map, path)
