"""Readers and writers of vector maps (room: maps; host).

In: a path. Out: SemanticMap, whatever the format.
"""

import json
from pathlib import Path

from semloc_jax.errors import SemlocError
from semloc_jax.maps.io.drive_geojson import map_from_drive_geojson, write_drive_geojson
from semloc_jax.maps.semantic_map import SemanticMap

__all__ = ["read_map", "write_drive_geojson"]


def read_map(path: str | Path) -> SemanticMap:
    path = Path(path)
    return map_from_drive_geojson(json.loads(path.read_text(encoding="utf-8")), path.name)
