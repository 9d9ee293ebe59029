"""Local metres and the earth, against PROJ."""

import numpy as np
import pyproj
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.geometry import geodesy

ORIGIN = (48.0712, 11.6523, 512.0)
SOUTH = (-33.8568, 151.2153, 5.0)


def proj_enu(origin, lat, lon, alt):
    pipeline = (
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={origin[0]} +lon_0={origin[1]} +h_0={origin[2]}"
    )
    return np.stack(pyproj.Transformer.from_pipeline(pipeline).transform(lon, lat, alt), axis=-1)


@pytest.mark.parametrize("origin", [ORIGIN, SOUTH])
def test_enu_equals_proj_and_comes_back(origin):
    rng = np.random.default_rng(0)
    lat, lon = origin[0] + rng.uniform(-0.2, 0.2, 50), origin[1] + rng.uniform(-0.2, 0.2, 50)
    alt = origin[2] + rng.uniform(-100, 400, 50)
    p_enu = geodesy.enu_from_wgs84(lat, lon, alt, origin)
    assert np.abs(p_enu - proj_enu(origin, lat, lon, alt)).max() < 1e-6
    back = geodesy.wgs84_from_enu(p_enu, origin)
    assert np.abs(np.array(back) - [lat, lon, alt]).max() < 1e-8


def test_a_metre_is_a_metre():
    """At 48 deg north one arc second is 30.9 m of latitude and 20.7 m of longitude."""
    p_enu = geodesy.enu_from_wgs84(ORIGIN[0] + 1 / 3600, ORIGIN[1] + 1 / 3600, ORIGIN[2] + 1, ORIGIN)
    assert p_enu == pytest.approx([20.70, 30.89, 1.0], abs=0.01)
    assert geodesy.enu_from_wgs84(*ORIGIN, ORIGIN) == pytest.approx([0, 0, 0], abs=1e-9)


def test_ecef_holds_at_the_poles():
    p_ecef = geodesy.ecef_from_wgs84(np.array([90.0, -90.0, 0.0]), np.array([0.0, 10.0, 180.0]), 100.0)
    assert p_ecef[0] == pytest.approx([0, 0, 6356852.314], abs=1e-3)
    lat, _, alt = geodesy.wgs84_from_ecef(p_ecef)
    assert lat == pytest.approx([90, -90, 0], abs=1e-9)
    assert alt == pytest.approx(100.0, abs=1e-6)


def test_projected_grid_loses_its_scale_and_convergence():
    """4 km at the rim of a UTM zone: the grid is stretched by up to 1 m per km and turned by over 2 deg."""
    origin = (48.0, 11.9, 500.0)
    crs = geodesy.utm_crs(*origin[:2])
    assert crs == "EPSG:32632"
    lat, lon = np.array([48.0, 48.02, 47.99]), np.array([11.9, 11.93, 11.85])
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    east, north = to_grid.transform(lon, lat)
    p_enu = geodesy.enu_from_projected(np.stack([east, north, np.full(3, 510.0)], axis=-1), crs, origin)
    assert np.abs(p_enu - proj_enu(origin, lat, lon, np.full(3, 510.0))).max() < 1e-4
    naive = np.stack([east - east[0], north - north[0]], axis=-1)
    assert np.linalg.norm(naive[1] - p_enu[1, :2]) > 50.0


def test_utm_zone_south():
    assert geodesy.utm_crs(*SOUTH[:2]) == "EPSG:32756"


def test_bad_coordinates_are_refused():
    with pytest.raises(SemlocError, match="swapped"):
        geodesy.enu_from_wgs84(691607.0, 5335000.0, 0.0, ORIGIN)
    with pytest.raises(SemlocError, match="EPSG:32632"):
        geodesy.enu_from_projected(np.zeros((1, 3)), "EPSG:0", ORIGIN)
    with pytest.raises(SemlocError, match="outside"):
        geodesy.enu_from_projected(np.full((1, 3), 1e30), "EPSG:32632", ORIGIN)
