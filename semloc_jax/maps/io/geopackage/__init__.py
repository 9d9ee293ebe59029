"""GeoPackage, the native store of maps: written and read whole, or asked place by place (room: maps; host).

In: a SemanticMap or a path. Out: the file, or a StoredMap, which reads the elements of a query.
The layer `elements` keeps every field of an element exactly; other programs show it like any other layer.
"""

import contextlib
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.io.features import feature_class
from semloc_jax.maps.io.geopackage import schema
from semloc_jax.maps.io.geopackage.foreign import read_foreign
from semloc_jax.maps.io.geopackage.geometry import to_blob
from semloc_jax.maps.io.geopackage.stored_map import StoredMap
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.storage import writing

__all__ = ["StoredMap", "read_geopackage", "write_geopackage"]


def write_geopackage(semantic_map: SemanticMap, path: str | Path, members: Mapping[str, Any] | None = None) -> None:
    """Writes a map as a GeoPackage with an R-tree; a file that is there is replaced once the new one is complete.

    The bytes follow from the map alone: equal maps are equal files.

    Args:
        semantic_map: the map.
        path: the .gpkg file.
        members: what the file states besides, such as the number of its version.

    Raises:
        SemlocError: the file cannot be written, or an attribute has no form in JSON.
    """
    try:
        with writing(path) as partial:
            with contextlib.closing(schema.create(partial)) as connection:
                _fill(connection, semantic_map, members or {})
            schema.forget_writer(partial)
    except (OSError, sqlite3.Error) as error:
        raise SemlocError(f"cannot write map {path}: {error}; give a path in a folder that exists") from error
    except (TypeError, ValueError) as error:
        raise SemlocError(f"cannot write map {path}: an attribute has no form in JSON ({error})") from error


def read_geopackage(path: str | Path) -> SemanticMap:
    """Returns the map of a GeoPackage: a StoredMap of our own layer, or the layers of another program.

    Raises:
        SemlocError: not a GeoPackage, broken, or without a layer that can be read.
    """
    path = Path(path)
    try:
        connection = schema.connect(path)
        if connection.is_table("semloc_map") and connection.is_table(schema.LAYER):
            return StoredMap(connection, path.name)
        return read_foreign(connection, path.name)
    except (sqlite3.Error, UnicodeDecodeError) as error:
        # SQLite quotes a broken schema with its line breaks.
        why = " ".join(str(error).split())[:160]
        raise SemlocError(f"map {path.name}: not a readable GeoPackage ({why}); is the file complete?") from error


def _fill(connection: sqlite3.Connection, semantic_map: SemanticMap, more: Mapping[str, Any]) -> None:
    srs = schema.UNKNOWN_SRS if semantic_map.origin is None else schema.LOCAL_SRS
    members = {
        "version": 1,
        "name": semantic_map.name,
        "origin": semantic_map.origin,
        "frame": semantic_map.frame,
        "skipped": dict(semantic_map.skipped),
        **more,
    }
    rows = ((key, json.dumps(value, allow_nan=False)) for key, value in members.items())
    connection.executemany("INSERT INTO semloc_map VALUES (?, ?)", rows)
    boxes = np.array([[*e.points[:, :2].min(axis=0), *e.points[:, :2].max(axis=0)] for e in semantic_map.elements])
    boxes = boxes.reshape(-1, 4)
    marks = ", ".join("?" * 18)
    connection.executemany(f"INSERT INTO elements VALUES ({marks})", _rows(semantic_map.elements, srs))
    index = ((fid, box[0], box[2], box[1], box[3]) for fid, box in enumerate(boxes.tolist(), start=1))
    connection.executemany(f"INSERT INTO {schema.INDEX} VALUES (?, ?, ?, ?, ?)", index)
    whole = (*boxes[:, :2].min(axis=0), *boxes[:, 2:].max(axis=0)) if len(boxes) else (0.0,) * 4
    schema.finish(connection, semantic_map.name, tuple(float(v) for v in whole), semantic_map.origin)


def _rows(elements: Iterable[MapElement], srs: int) -> Iterator[tuple[object, ...]]:
    for fid, e in enumerate(elements, start=1):
        normal = (None,) * 3 if e.normal is None else tuple(float(v) for v in e.normal)
        yield (
            fid,
            to_blob(e.points, e.closed, srs),
            e.id,
            feature_class(e),
            e.style,
            e.shape,
            e.closed,
            float(e.width_m),
            float(e.radius_m),
            float(e.radius_top_m),
            float(e.height_m),
            *normal,
            *e.true_ends,
            e.has_height,
            json.dumps(dict(e.attributes), allow_nan=False),
        )
