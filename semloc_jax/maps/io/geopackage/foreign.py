"""GeoPackages of other programs: layers with a column `class`, or named after a class (room: maps; host).

In: a connection. Out: SemanticMap. Columns have the property names of our GeoJSON; layers may be in degrees, in a grid
or in local metres.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import enu_from_projected, enu_from_wgs84
from semloc_jax.maps.elements import GeoOrigin, MapElement
from semloc_jax.maps.io.features import element_from_feature, feature_id
from semloc_jax.maps.io.geopackage import schema
from semloc_jax.maps.io.geopackage.geometry import from_blob
from semloc_jax.maps.semantic_map import SemanticMap

_MOST_FEATURES = 2_000_000


def read_foreign(connection: schema.GuardedConnection, name: str) -> SemanticMap:
    """Returns the map in the feature layers of a GeoPackage of another program.

    Raises:
        SemlocError: no layer, or one whose reference system is unknown.
    """
    layers = connection.ask(
        "SELECT c.table_name, g.column_name, c.srs_id, s.organization, s.organization_coordsys_id FROM gpkg_contents c "
        "JOIN gpkg_geometry_columns g ON g.table_name = c.table_name "
        "JOIN gpkg_spatial_ref_sys s ON s.srs_id = c.srs_id WHERE c.data_type = 'features'"
    )
    if not layers:
        raise SemlocError(f"map {name}: a GeoPackage without feature layers; expected lines, outlines or points")
    origin: GeoOrigin | None = None
    elements: list[MapElement] = []
    skipped: Counter[str] = Counter()
    faulty: dict[str, str] = {}
    for table, column, srs_id, organization, code in layers:
        where = f"map {name}: layer {str(table)[:40]}"
        if not connection.is_table(table):
            raise SemlocError(f"{where}: is no table; expected a plain layer")
        features = list(_features(connection, table, column, where))
        crs = "" if srs_id in (-1, 0) else f"{organization}:{code}"
        if features and crs and origin is None:
            origin = _middle(features, crs, where)
        to_local = _to_local(crs, origin)
        for index, (properties, points, closed, has_height) in enumerate(features):
            feature = _feature(properties, points, closed, has_height)
            try:
                element = element_from_feature(feature, index, f"{name}: layer {table}", to_local)
            except SemlocError as error:
                faulty[f"{table} {feature_id(feature, index)}"] = str(error)
                continue
            if isinstance(element, str):
                skipped[element] += 1
            else:
                elements.append(element)
    return SemanticMap(tuple(elements), origin, name, dict(skipped), faulty=faulty)


def _features(connection: schema.GuardedConnection, table: str, column: str, where: str) -> Iterator[Any]:
    """Yields properties, points, whether closed and with heights, of each feature of a layer."""
    quoted = table.replace('"', '""')
    names = [row[1] for row in connection.ask(f'PRAGMA table_info("{quoted}")')]
    if column not in names:
        raise SemlocError(f"{where}: has no column {column}")
    place = names.index(column)
    for row in connection.ask(f'SELECT * FROM "{quoted}" LIMIT {_MOST_FEATURES}'):
        if row[place] is None:
            continue
        properties = {key: value for key, value in zip(names, row, strict=True) if key != column and value is not None}
        properties.setdefault("class", table)
        yield (properties, *from_blob(row[place], where))


def _feature(properties: dict[str, Any], points: np.ndarray, closed: bool, has_height: bool) -> dict[str, Any]:
    """Returns a GeoJSON feature; an upright thing given as a point with a height becomes its axis."""
    properties = {key: value for key, value in properties.items() if isinstance(value, str | int | float)}
    for key in ("normal", "true_ends"):
        if isinstance(properties.get(key), str):
            properties[key] = json.loads(properties[key])
    if len(points) == 1:
        height = properties.get("height")
        top = float(height) if isinstance(height, int | float) else 0.0
        points = np.vstack([points, points + [0.0, 0.0, top]])
    coordinates = points[:, : 3 if has_height else 2].tolist()
    shape = {"type": "LineString", "coordinates": coordinates}
    if closed:
        shape = {"type": "Polygon", "coordinates": [[*coordinates, coordinates[0]]]}
    found = {"type": "Feature", "properties": properties, "geometry": shape}
    return found | ({"id": properties["id"]} if "id" in properties else {})


def _middle(features: list[Any], crs: str, where: str) -> GeoOrigin:
    """Returns the middle of the first points of a layer on the earth."""
    first = np.array([points[0] for _, points, _, _ in features])
    middle = 0.5 * (first.min(axis=0) + first.max(axis=0))
    lon, lat = middle[:2] if crs == "EPSG:4326" else _degrees(middle, crs, where)
    if not (abs(lat) <= 90.0 and abs(lon) <= 180.0):
        raise SemlocError(f"{where}: its middle is at {lat:g}, {lon:g}; expected latitude and longitude")
    return GeoOrigin(round(float(lat), 5), round(float(lon), 5), round(float(np.median(first[:, 2])), 1))


def _degrees(point: np.ndarray, crs: str, where: str) -> tuple[float, float]:
    import pyproj

    try:
        return pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(point[0], point[1])
    except pyproj.exceptions.ProjError as error:
        raise SemlocError(f"{where}: reference system {crs} is unknown; expected an EPSG code") from error


def _to_local(crs: str, origin: GeoOrigin | None) -> Callable[[np.ndarray], np.ndarray] | None:
    if not crs or origin is None:
        return None
    if crs == "EPSG:4326":
        return lambda points: enu_from_wgs84(points[:, 1], points[:, 0], points[:, 2], origin)
    return lambda points: enu_from_projected(points, crs, origin)
