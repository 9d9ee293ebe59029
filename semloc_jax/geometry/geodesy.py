"""Local metres and the earth: ENU tangent frame <-> WGS84 <-> projected grids (room: geometry; host, float64).

In: latitude, longitude [deg], ellipsoidal height [m], or grid coordinates with their CRS. Out: ENU [m], and back.
The closed forms need no library; pyproj is loaded only for projected grids.
"""

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from semloc_jax.errors import SemlocError

_SEMI_MAJOR_M = 6378137.0
_FLATTENING = 1 / 298.257223563
_E2 = _FLATTENING * (2 - _FLATTENING)
_NUM_LATITUDE_STEPS = 6

Geodetic = tuple[float, float, float]
"""Latitude [deg], longitude [deg], ellipsoidal height [m] of the origin of a local frame."""


def ecef_from_wgs84(lat_deg: ArrayLike, lon_deg: ArrayLike, alt_m: ArrayLike) -> Float[np.ndarray, "*n 3"]:
    """Earth-centred, earth-fixed coordinates [m].

    Raises:
        SemlocError: A latitude beyond 90 deg or a longitude beyond 360 deg.
    """
    lat_deg, lon_deg, alt_m = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (lat_deg, lon_deg, alt_m)))
    if np.any(np.abs(lat_deg) > 90) or np.any(np.abs(lon_deg) > 360):
        raise SemlocError(
            f"latitude up to {np.abs(lat_deg).max():.6g}, longitude up to {np.abs(lon_deg).max():.6g}; "
            "expected degrees within 90 and 360; are they swapped, or in metres?"
        )
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    normal = _SEMI_MAJOR_M / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
    ring = (normal + alt_m) * np.cos(lat)
    return np.stack([ring * np.cos(lon), ring * np.sin(lon), (normal * (1 - _E2) + alt_m) * np.sin(lat)], axis=-1)


def wgs84_from_ecef(p_ecef: Float[np.ndarray, "*n 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude [deg], longitude [deg], ellipsoidal height [m] of points near the surface of the earth."""
    x, y, z = np.moveaxis(np.asarray(p_ecef, dtype=np.float64), -1, 0)
    ring = np.hypot(x, y)
    lat = np.arctan2(z, ring * (1 - _E2))
    for _ in range(_NUM_LATITUDE_STEPS):
        normal = _SEMI_MAJOR_M / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + _E2 * normal * np.sin(lat), ring)
    normal = _SEMI_MAJOR_M / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
    # This form of the height has no division and holds at the poles as well.
    alt_m = ring * np.cos(lat) + z * np.sin(lat) - _SEMI_MAJOR_M**2 / normal
    return np.degrees(lat), np.degrees(np.arctan2(y, x)), alt_m


def enu_from_wgs84(
    lat_deg: ArrayLike, lon_deg: ArrayLike, alt_m: ArrayLike, origin: Geodetic
) -> Float[np.ndarray, "*n 3"]:
    """East, north, up [m] in the plane that touches the ellipsoid's normal at `origin`."""
    return (ecef_from_wgs84(lat_deg, lon_deg, alt_m) - ecef_from_wgs84(*origin)) @ _R_ecef_enu(origin)


def wgs84_from_enu(p_enu: Float[np.ndarray, "*n 3"], origin: Geodetic) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude [deg], longitude [deg], ellipsoidal height [m] of points in the ENU frame of `origin`."""
    return wgs84_from_ecef(np.asarray(p_enu, dtype=np.float64) @ _R_ecef_enu(origin).T + ecef_from_wgs84(*origin))


def enu_from_projected(points: Float[np.ndarray, "n 3"], crs: str, origin: Geodetic) -> Float[np.ndarray, "n 3"]:
    """ENU [m] of grid coordinates (easting, northing, ellipsoidal height): scale and convergence of the grid removed.

    Args:
        points: Coordinates in the grid, x to the east first [m].
        crs: Name of the grid as pyproj knows it, such as EPSG:32633.
        origin: Where the ENU frame sits.

    Raises:
        SemlocError: The grid is unknown, or points lie outside of where it is defined.
    """
    import pyproj

    try:
        transformer = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    except pyproj.exceptions.CRSError as error:
        raise SemlocError(f"grid '{crs}': unknown; expected a name such as {utm_crs(*origin[:2])}") from error
    lon_deg, lat_deg = transformer.transform(points[:, 0], points[:, 1])
    if not np.isfinite(lat_deg).all():
        raise SemlocError(f"grid '{crs}': points lie outside of it; expected easting and northing in metres")
    return enu_from_wgs84(lat_deg, lon_deg, points[:, 2], origin)


def utm_crs(lat_deg: float, lon_deg: float) -> str:
    """Name of the UTM grid at a place."""
    zone = int((lon_deg + 180) // 6) % 60 + 1
    return f"EPSG:{32600 + zone if lat_deg >= 0 else 32700 + zone}"


def _R_ecef_enu(origin: Geodetic) -> Float[np.ndarray, "3 3"]:
    lat, lon = np.radians(origin[0]), np.radians(origin[1])
    east = [-np.sin(lon), np.cos(lon), 0.0]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return np.array([east, north, up]).T
