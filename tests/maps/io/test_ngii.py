"""Korean precise road maps, on small shapefiles that GDAL writes in Korea 2000."""

import numpy as np
import pytest
import shapely

from semloc_jax.errors import SemlocError
from semloc_jax.maps import read_lane_centers, read_map
from semloc_jax.structs import ElementClass
from tests.maps.io.ngii_files import box, line, write_layer, write_ngii

pyogrio = pytest.importorskip("pyogrio")


@pytest.fixture
def folder(tmp_path):
    return write_ngii(tmp_path)


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
    write_layer(folder, "C4_SPEEDBUMP", [box(0, 0)], crs="EPSG:32652", ID=["z"])
    with pytest.raises(SemlocError, match="expected one for all"):
        read_map(folder)
    (folder / "C4_SPEEDBUMP.shp").write_bytes(b"nothing")
    with pytest.raises(SemlocError, match="cannot be read|expected one"):
        read_map(folder)


def test_driving_links_are_the_lanes(folder):
    road = read_map(folder)
    assert read_lane_centers(folder, road.origin) == []
    write_layer(folder, "A2_LINK", [line(0, 40, 1.5), line(40, 0, 4.5)], ID=["m", "n"])
    there, back = read_lane_centers(folder, road.origin)
    np.testing.assert_allclose(there[-1] - there[0], [40.0, 0.0, 0.0], atol=0.01)
    np.testing.assert_allclose(back[-1] - there[0], [0.0, 3.0, 0.0], atol=0.01)


def test_a_map_in_degrees_is_the_map_in_metres(folder, tmp_path_factory):
    """Widths and dashes are metres: a line of 40 m has five bars, not one of three degrees."""
    in_degrees = tmp_path_factory.mktemp("degrees")
    pyproj = pytest.importorskip("pyproj")
    to_degrees = pyproj.Transformer.from_crs("EPSG:5186", "EPSG:4326", always_xy=True).transform

    def moved(shape):
        def one(p):
            return np.column_stack([*to_degrees(p[:, 0], p[:, 1]), p[:, 2]])

        return shapely.transform(shape, one, include_z=True)

    lines = [line(0, 40, 0), line(0, 40, 3), line(38, 38.1, 0), line(0, 40, 6)]
    values = {"ID": ["a", "b", "c", "d"], "Kind": ["501", "503", "530", "501"], "Type": ["121", "212", "211", "114"]}
    write_layer(in_degrees, "B2_SURFACELINEMARK", [moved(line) for line in lines], crs="EPSG:4326", **values)
    road, same = read_map(in_degrees), read_map(folder)
    bars = {e.id: e for e in road.elements if e.id.startswith("b_")}
    assert len(bars) == 5 and all(e.length_m == pytest.approx(3.0, abs=1e-3) for e in bars.values())
    assert np.abs(road.extent[1] - road.extent[0])[:2].max() < 50.0
    for key in ("aL", "b_0", "c"):
        mine, other = ({e.id: e for e in m.elements}[key].points for m in (road, same))
        assert np.linalg.norm(mine[-1] - mine[0]) == pytest.approx(np.linalg.norm(other[-1] - other[0]), abs=2e-3)


def test_layers_that_are_not_read_are_counted(folder):
    write_layer(folder, "C3_VEHICLEPROTECTIONSAFETY", [line(0, 40, 9), line(0, 40, 12)], ID=["h", "i"], Type=["1", "2"])
    road = read_map(folder)
    assert road.skipped["layer C3_VEHICLEPROTECTIONSAFETY"] == 2
    assert road.skipped["C6_POSTPOINT: kept, but no contour (points without a height)"] == 1
