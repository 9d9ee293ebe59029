"""The true obstacles of a drive (room: reports; host).

In: a drive with a map in the layout of drives and true poses. Out: ObjectErrors.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.perception.obstacle_classes import OBSTACLES
from semloc_jax.reports.object_errors import ObjectErrors, TrueThings
from semloc_jax.storage import json_document, reading


def obstacle_errors(drive: Drive) -> ObjectErrors:
    """The true obstacles of a drive, where it has a map as GeoJSON and true poses.

    Ground locks and signs are no elements of maps to localize in: they are points of the file, with their class.
    """
    places: list[np.ndarray] = []
    kinds: list[str] = []
    if drive.truth is not None and drive.map_path is not None and drive.map_path.suffix in (".geojson", ".json"):
        where = f"map {drive.map_path.name}"
        with reading(where):
            document = json_document(drive.map_path.read_bytes(), where)
        for feature in document.get("features", ()):
            kind = feature.get("properties", {}).get("class") if isinstance(feature, Mapping) else None
            if kind in OBSTACLES:
                kinds.append(kind)
                places.append(_middle(feature, where))
    poses = np.column_stack([np.array(places).reshape(-1, 2), np.zeros(len(places))])
    return ObjectErrors(drive, TrueThings(poses, tuple(kinds)))


def _middle(feature: Mapping[str, Any], where: str) -> np.ndarray:
    """Middle of the footprint: a point, the foot of an axis, or an outline."""
    try:
        geometry = feature["geometry"]
        places = np.asarray(geometry["coordinates"], float)
        if geometry["type"] == "Polygon":
            return places[0, :-1, :2].mean(axis=0)
        return places[:2] if geometry["type"] == "Point" else places[0, :2]
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise SemlocError(
            f"{where}: obstacle {feature.get('id')!r}: expected a Point, a LineString or a Polygon with numbers"
        ) from error
