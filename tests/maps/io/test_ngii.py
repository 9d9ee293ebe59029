"""Korean precise road maps, on small shapefiles that GDAL writes in Korea 2000."""

import numpy as np
import pytest
import shapely

from semloc_jax.errors import SemlocError
from semloc_jax.maps import read_lane_centers, read_map
from semloc_jax.structs import ElementClass

pyogrio = pytest.importorskip("pyogrio")
EAST, NORTH = 200_000.0, 550_000.0
"""A place on the central meridian of EPSG:5186, Seoul's grid, where its scale is 1."""


def _write(folder, layer: str, shapes, crs="EPSG:5186", **fields):
    names, values = list(fields), [np.array(v, dtype=object) for v in fields.values()]
    kind = f"{shapes[0].geom_type} Z"
    blobs = shapely.to_wkb(np.array(shapes, dtype=object), output_dimension=3)
    pyogrio.raw.write(
        folder / f"{layer}.shp", blobs, values, names, driver="ESRI Shapefile", geometry_type=kind, crs=crs
    )


def _line(x0, x1, y, z=30.0):
    return shapely.LineString([(EAST + x0, NORTH + y, z), (EAST + x1, NORTH + y, z)])


def _box(x, y, z=30.0):
    corners = [(0, 0), (1, 0), (1, 3), (0, 3)]
    return shapely.Polygon([(EAST + x + dx, NORTH + y + dy, z) for dx, dy in corners])


@pytest.fixture
def folder(tmp_path):
    lines = [_line(0, 40, 0), _line(0, 40, 3), _line(38, 38.1, 0), _line(0, 40, 6)]
    values = {"ID": ["a", "b", "c", "d"], "Kind": ["501", "503", "530", "501"], "Type": ["121", "212", "211", "114"]}
    _write(tmp_path, "B2_SURFACELINEMARK", lines, **values)
    _write(tmp_path, "B3_SURFACEMARK", [_box(10, 1), _box(20, 1)], ID=["e", "f"], Kind=["5371", "5321"])
    _write(tmp_path, "C6_POSTPOINT", [shapely.Point(EAST, NORTH, 30.0)], ID=["g"], Type=["1"])
    return tmp_path


def test_marks_of_every_type(folder):
    road = read_map(folder)
    by_id = {e.id: e for e in road.elements}
    assert {"aL", "aR", "c", "e", "f", "g", "dL"} <= set(by_id)
    assert by_id["aL"].style == by_id["aR"].style == "solid" and by_id["aL"].attributes["color"] == "yellow"
    assert by_id["c"].label == ElementClass.STOP_LINE and by_id["c"].width_m == 0.45
    assert by_id["e"].label == ElementClass.ROAD_MARK and by_id["f"].label == ElementClass.CROSSWALK
    assert by_id["g"].is_logical and by_id["g"].label == ElementClass.POLE
    bars = [e for e in road.elements if e.id.startswith("b_")]
    assert len(bars) == 5 and all(e.length_m == pytest.approx(3.0, abs=1e-3) for e in bars)
    assert by_id["dL"].style == "solid" and sum(e.id.startswith("dR_") for e in road.elements) == 5


def test_the_grid_becomes_metres_of_the_earth(folder):
    road = read_map(folder)
    assert road.origin is not None and road.origin.lon_deg == pytest.approx(127.0, abs=1e-3)
    assert road.origin.lat_deg == pytest.approx(37.55, abs=0.01) and road.origin.alt_m == 30.0
    line = next(e for e in road.elements if e.id == "aL")
    assert line.has_height and line.length_m == pytest.approx(40.0, abs=1e-3)


def test_layers_in_two_systems_and_broken_ones_are_refused(folder):
    _write(folder, "C4_SPEEDBUMP", [_box(0, 0)], crs="EPSG:32652", ID=["z"])
    with pytest.raises(SemlocError, match="expected one for all"):
        read_map(folder)
    (folder / "C4_SPEEDBUMP.shp").write_bytes(b"nothing")
    with pytest.raises(SemlocError, match="cannot be read|expected one"):
        read_map(folder)


def test_driving_links_are_the_lanes(folder):
    road = read_map(folder)
    assert read_lane_centers(folder, road.origin) == []
    _write(folder, "A2_LINK", [_line(0, 40, 1.5), _line(40, 0, 4.5)], ID=["m", "n"])
    there, back = read_lane_centers(folder, road.origin)
    np.testing.assert_allclose(there[-1] - there[0], [40.0, 0.0, 0.0], atol=0.01)
    np.testing.assert_allclose(back[-1] - there[0], [0.0, 3.0, 0.0], atol=0.01)
