"""Where the local metres of an Autoware map lie on the earth: map_projector_info.yaml, MGRS squares (room: maps; host).

In: the file beside a map, or the MGRS code of a node. Out: LocalGrid, the grid of local_x and local_y.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import enu_from_projected, enu_from_wgs84, utm_crs, wgs84_from_enu
from semloc_jax.maps.elements import GeoOrigin

FILE_NAME = "map_projector_info.yaml"
_SQUARE_M = 100_000.0
_ROW_CYCLE_M = 2_000_000.0
_BANDS = "CDEFGHJKLMNPQRSTUVWX"
_ROWS = "ABCDEFGHJKLMNPQRSTUV"
_COLUMNS = ("STUVWXYZ", "ABCDEFGH", "JKLMNPQR")
_METRES_PER_DEGREE = 110_600.0


@dataclass(frozen=True)
class LocalGrid:
    """The frame of local_x, local_y.

    Attributes:
        name: as text.
        crs: grid whose axes it has; empty where it is an ENU frame or unknown.
        zero: grid coordinates of its origin, `float64[3]` [m].
        origin: place of an ENU frame (LocalCartesian), else None.
    """

    name: str
    crs: str = ""
    zero: np.ndarray | None = None
    origin: GeoOrigin | None = None

    @property
    def is_known(self) -> bool:
        """Whether the frame has a place on the earth."""
        return bool(self.crs) or self.origin is not None

    def to_enu(self, local: np.ndarray, origin: GeoOrigin) -> np.ndarray:
        """Returns local coordinates `[n 3]` in the ENU frame of an origin."""
        if self.origin is not None:
            return enu_from_wgs84(*wgs84_from_enu(local, self.origin), origin)
        assert self.zero is not None
        return enu_from_projected(local + self.zero, self.crs, origin)

    def from_geodetic(self, lat: np.ndarray, lon: np.ndarray, alt: np.ndarray) -> np.ndarray:
        """Returns places on the earth in the local frame, `[n 3]`."""
        if self.origin is not None:
            return enu_from_wgs84(lat, lon, alt, self.origin)
        import pyproj

        assert self.zero is not None
        x, y = pyproj.Transformer.from_crs("EPSG:4326", self.crs, always_xy=True).transform(lon, lat)
        return np.stack([x, y, alt], axis=-1) - self.zero


def grid_beside(path: Path) -> LocalGrid | None:
    """Returns the frame that the map_projector_info.yaml in the folder of a map names; None without such a file.

    Raises:
        SemlocError: the file cannot be read or names an unknown projector.
    """
    info = path.with_name(FILE_NAME)
    if not info.is_file():
        return None
    import yaml

    try:
        members = yaml.safe_load(info.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise SemlocError(f"{info.name} beside map {path.name}: not valid YAML ({str(error)[:80]})") from error
    if not isinstance(members, dict):
        raise SemlocError(f"{info.name} beside map {path.name}: expected projector_type and its values")
    return _grid(members, f"{info.name} beside map {path.name}")


def grid_of_mgrs(code: str) -> LocalGrid:
    """Returns the frame of a 100 km square of the military grid, such as 54SUE: metres from its south-west corner.

    Raises:
        SemlocError: no such square.
    """
    found = re.match(r"(\d{1,2})([C-HJ-NP-X])([A-HJ-NP-Z])([A-HJ-NP-V])", code.strip().upper())
    zone = int(found.group(1)) if found else 0
    column = _COLUMNS[zone % 3].find(found.group(3)) if found else -1
    if not found or not 1 <= zone <= 60 or column < 0:
        raise SemlocError(f"MGRS square '{code[:20]}'; expected zone, band and two letters such as 54SUE")
    row = (_ROWS.index(found.group(4)) - (5 if zone % 2 == 0 else 0)) % 20
    band = _BANDS.index(found.group(2))
    is_north = found.group(2) >= "N"
    # The letters of rows repeat every 2,000 km; the band, 8 degrees high, says which of them it is.
    lowest = (8.0 * band - 80.0) * _METRES_PER_DEGREE + (0.0 if is_north else 10_000_000.0)
    northing = row * _SQUARE_M
    northing += _ROW_CYCLE_M * np.ceil((lowest - _SQUARE_M - northing) / _ROW_CYCLE_M)
    zero = np.array([(column + 1) * _SQUARE_M, northing, 0.0])
    return LocalGrid(f"MGRS {found.group(0)}", f"EPSG:{32600 + zone if is_north else 32700 + zone}", zero)


def _grid(members: dict[str, Any], where: str) -> LocalGrid:
    kind = str(members.get("projector_type", ""))
    if kind == "MGRS":
        return grid_of_mgrs(str(members.get("mgrs_grid", "")))
    if kind.lower() == "local":
        return LocalGrid("local metres")
    place = members.get("map_origin")
    try:
        lat, lon = float(place["latitude"]), float(place["longitude"])
        origin = GeoOrigin(lat, lon, float(place.get("altitude", 0.0)))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SemlocError(f"{where}: map_origin {str(place)[:60]}; expected latitude and longitude") from error
    if not (abs(lat) < 85.0 and abs(lon) <= 180.0 and abs(origin.alt_m) < 1e5):
        raise SemlocError(f"{where}: map_origin {lat:g}, {lon:g}; expected a place on the earth")
    if kind == "LocalCartesian":
        return LocalGrid("local Cartesian", origin=origin)
    if kind == "LocalCartesianUTM":
        return _about(origin, utm_crs(lat, lon), "local UTM")
    if kind == "TransverseMercator":
        scale = members.get("scale_factor", 0.9996)
        if not isinstance(scale, int | float) or not 0.9 < scale < 1.1:
            raise SemlocError(f"{where}: scale_factor {str(scale)[:20]}; expected about 0.9996")
        crs = f"+proj=tmerc +lat_0={lat!r} +lon_0={lon!r} +k_0={float(scale)!r} +x_0=0 +y_0=0 +datum=WGS84 +units=m"
        return _about(origin, crs, "transverse Mercator")
    raise SemlocError(
        f"{where}: projector_type '{kind[:40]}'; expected MGRS, LocalCartesian, LocalCartesianUTM, "
        "TransverseMercator or Local"
    )


def _about(origin: GeoOrigin, crs: str, name: str) -> LocalGrid:
    import pyproj

    transformer = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    x, y = transformer.transform(origin.lon_deg, origin.lat_deg)
    return LocalGrid(f"{name} about {origin.lat_deg:g}, {origin.lon_deg:g}", crs, np.array([x, y, origin.alt_m]))
