"""GeoJSON after RFC 7946: WGS84 longitude, latitude and ellipsoidal height (room: maps; host).

In: a FeatureCollection with the property names of `features`. Out: SemanticMap in the ENU frame of an origin, and back.
The foreign member `origin` {lat_deg, lon_deg, alt_m} fixes the frame; without it the middle of the features is taken.
"""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import enu_from_wgs84, wgs84_from_enu
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io.features import (
    element_from_feature,
    elements_from_features,
    feature_from_element,
    write_features,
)
from semloc_jax.maps.semantic_map import SemanticMap

_DECIMALS_DEG = 9
"""0.1 mm of latitude."""


def map_from_geojson(document: Mapping[str, Any], name: str, origin: GeoOrigin | None = None) -> SemanticMap:
    """Returns the map in a parsed RFC 7946 document, in the ENU frame of `origin`.

    Args:
        document: the FeatureCollection.
        name: what to call the map in messages.
        origin: place of the local frame; None takes the one the file names, else the middle of its features.

    Raises:
        SemlocError: coordinates beyond 180 and 90 degrees, NaN, or a geometry that does not fit its class.
    """
    origin = origin or _named_origin(document, name) or _middle(document, name)

    def to_local(lon_lat_alt: np.ndarray) -> np.ndarray:
        _require_degrees(lon_lat_alt, name)
        lon, lat, alt = lon_lat_alt.T
        return enu_from_wgs84(lat, lon, alt, origin)

    elements, skipped, faulty = elements_from_features(document, name, to_local)
    return SemanticMap(elements, origin, name, skipped, str(document.get("frame_name", "")), faulty)


def write_geojson(semantic_map: SemanticMap, path: str | Path) -> None:
    """Writes a map as RFC 7946 GeoJSON (WGS84, 0.1 mm), with its origin as a foreign member.

    Raises:
        SemlocError: the map does not know where on earth it is.
    """
    origin = semantic_map.origin
    if origin is None:
        raise SemlocError(
            f"map {semantic_map.name} has no origin on the earth; RFC 7946 needs longitude and latitude: "
            "give the map a GeoOrigin or write the drive layout"
        )

    def to_file(points: np.ndarray) -> np.ndarray:
        lat, lon, alt = wgs84_from_enu(points, origin)
        return np.stack([lon.round(_DECIMALS_DEG), lat.round(_DECIMALS_DEG), alt.round(4)], axis=-1)

    features = [feature_from_element(element, to_file) for element in semantic_map.elements]
    members = {"name": semantic_map.name, "origin": origin._asdict()}
    members |= {"frame_name": semantic_map.frame} if semantic_map.frame else {}
    write_features(path, members, features)


def _named_origin(document: Mapping[str, Any], name: str) -> GeoOrigin | None:
    member = document.get("origin")
    if member is None:
        return None
    try:
        return GeoOrigin(float(member["lat_deg"]), float(member["lon_deg"]), float(member.get("alt_m", 0.0)))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SemlocError(f"map {name}: origin {member}; expected numbers lat_deg, lon_deg, alt_m") from error


def _middle(document: Mapping[str, Any], name: str) -> GeoOrigin:
    """Returns the middle of the first points of all features, rounded to about 1 m, at the median height."""
    first = np.array([*_first_points(document, name)])
    if not len(first):
        return GeoOrigin(0.0, 0.0)
    _require_degrees(first, name)
    lon, lat = 0.5 * (first[:, :2].min(axis=0) + first[:, :2].max(axis=0))
    return GeoOrigin(round(float(lat), 5), round(float(lon), 5), round(float(np.median(first[:, 2])), 1))


def _first_points(document: Mapping[str, Any], name: str) -> Iterator[list[float]]:
    """Yields the first point of each feature that can be read."""
    for index, feature in enumerate(document["features"]):
        with contextlib.suppress(SemlocError):
            element = element_from_feature(feature, index, name)
            if not isinstance(element, str):
                yield element.points[0].tolist()


def _require_degrees(lon_lat_alt: np.ndarray, name: str) -> None:
    if np.any(np.abs(lon_lat_alt[:, 0]) > 180.0) or np.any(np.abs(lon_lat_alt[:, 1]) > 90.0):
        worst = lon_lat_alt[np.argmax(np.abs(lon_lat_alt[:, :2]).max(axis=1))]
        raise SemlocError(
            f"map {name}: coordinates ({worst[0]:g}, {worst[1]:g}); expected longitude and latitude in degrees: "
            "a map in metres needs the member `frame` of the drive layout"
        )
