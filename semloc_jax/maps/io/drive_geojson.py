"""Maps of recorded drives: GeoJSON-like features in a local ENU frame in metres (room: maps; host).

In: a file whose member `frame` gives the origin. Out: SemanticMap, and the same file back.
"""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io.features import element_from_feature, feature_from_element
from semloc_jax.maps.semantic_map import SemanticMap

_FRAME_KIND = "local ENU, metres, x east y north z up"


def map_from_drive_geojson(document: Mapping[str, Any], name: str) -> SemanticMap:
    """Returns the map in a parsed drive map file; coordinates are taken as they are.

    Args:
        document: the FeatureCollection.
        name: what to call the map in messages.

    Raises:
        SemlocError: a feature has a wrong geometry for its class, NaN coordinates, or the origin is incomplete.
    """
    frame = document.get("frame") or {}
    try:
        origin = GeoOrigin(*(float(frame[key]) for key in ("origin_lat_deg", "origin_lon_deg", "origin_alt_m")))
    except (KeyError, TypeError, ValueError):
        origin = None
    skipped: Counter[str] = Counter()
    elements = []
    for index, feature in enumerate(document.get("features") or []):
        element = element_from_feature(feature, index, name)
        if isinstance(element, str):
            skipped[element] += 1
        else:
            elements.append(element)
    return SemanticMap(tuple(elements), origin, name, dict(skipped))


def write_drive_geojson(semantic_map: SemanticMap, path: str | Path) -> None:
    """Writes a map in the layout of a drive: metres in the local frame, 0.1 mm."""
    origin = semantic_map.origin
    frame: dict[str, Any] = {"kind": _FRAME_KIND}
    if origin is not None:
        frame |= {"origin_lat_deg": origin.lat_deg, "origin_lon_deg": origin.lon_deg, "origin_alt_m": origin.alt_m}
    document = {
        "type": "FeatureCollection",
        "name": semantic_map.name,
        "frame": frame,
        "features": [
            feature_from_element(element, lambda points: points.round(4)) for element in semantic_map.elements
        ],
    }
    try:
        Path(path).write_text(json.dumps(document, allow_nan=False), encoding="utf-8")
    except OSError as error:
        raise SemlocError(f"cannot write map {path}: {error.strerror}; give a path in a folder that exists") from error
