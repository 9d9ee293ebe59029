"""Maps of recorded drives: GeoJSON-like features in a local ENU frame in metres (room: maps; host).

In: a file whose member `frame` gives the origin. Out: SemanticMap, and the same file back.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io.features import elements_from_features, feature_from_element, write_features
from semloc_jax.maps.semantic_map import SemanticMap

_FRAME_KIND = "local ENU, metres, x east y north z up"


def map_from_drive_geojson(document: Mapping[str, Any], name: str) -> SemanticMap:
    """Returns the map in a parsed drive map file; coordinates are taken as they are.

    Args:
        document: the FeatureCollection.
        name: what to call the map in messages.

    Raises:
        SemlocError: an origin that is no place on earth.
    """
    elements, skipped, faulty = elements_from_features(document, name)
    frame = document.get("frame")
    frame_name = frame.get("name", "") if isinstance(frame, Mapping) else ""
    return SemanticMap(elements, _origin(frame, name), name, skipped, str(frame_name), faulty)


def write_drive_geojson(semantic_map: SemanticMap, path: str | Path, more: Sequence[Mapping[str, Any]] = ()) -> None:
    """Writes a map in the layout of a drive: metres in the local frame, 0.1 mm; `more` are features as they are."""
    origin = semantic_map.origin
    frame: dict[str, Any] = {"kind": _FRAME_KIND}
    if semantic_map.frame:
        frame["name"] = semantic_map.frame
    if origin is not None:
        frame |= {"origin_lat_deg": origin.lat_deg, "origin_lon_deg": origin.lon_deg, "origin_alt_m": origin.alt_m}
    features = [feature_from_element(element, lambda points: points.round(4)) for element in semantic_map.elements]
    write_features(path, {"name": semantic_map.name, "frame": frame}, [*features, *map(dict, more)])


def _origin(frame: Any, name: str) -> GeoOrigin | None:
    """Returns the place of the frame; None if the member names none."""
    if not isinstance(frame, Mapping) or "origin_lat_deg" not in frame:
        return None
    try:
        lat, lon, alt = (float(frame.get(f"origin_{key}", 0.0)) for key in ("lat_deg", "lon_deg", "alt_m"))
    except (TypeError, ValueError):
        lat = lon = alt = float("nan")
    if not (abs(lat) <= 90.0 and abs(lon) <= 180.0 and abs(alt) < 1e5):
        raise SemlocError(f"map {name}: origin {dict(frame)}; expected origin_lat_deg, origin_lon_deg and origin_alt_m")
    return GeoOrigin(lat, lon, alt)
