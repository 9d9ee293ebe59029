"""Frames of Autoware maps, and maps written as Lanelet2 and read again by us and by the lanelet2 library."""

import collections

import numpy as np
import pytest
from pyproj import Transformer

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import enu_from_wgs84
from semloc_jax.maps import GeoOrigin, MapElement, SemanticMap, read_map
from semloc_jax.maps.io.lanelet2 import read_lanelet2
from semloc_jax.maps.io.lanelet2_writer import write_lanelet2
from semloc_jax.maps.io.projector_info import grid_of_mgrs
from semloc_jax.structs import ElementClass

TOKYO = (35.6237, 139.7731)
ORIGIN = GeoOrigin(49.0065, 8.4353, 0.0)


@pytest.mark.parametrize(
    ("square", "lat", "lon"),
    [
        ("54SUE", *TOKYO),
        ("32UPU", 48.137, 11.575),
        ("18TWL", 40.713, -74.006),
        ("56HLH", -33.868, 151.207),
        ("31UDQ", 48.857, 2.352),
        ("23KLP", -23.55, -46.633),
        ("52SCG", 37.567, 126.978),
    ],
)
def test_squares_of_the_military_grid_hold_their_cities(square, lat, lon):
    grid = grid_of_mgrs(square)
    x, y, _ = grid.from_geodetic(np.array([lat]), np.array([lon]), np.zeros(1))[0]
    assert 0.0 <= x < 100_000.0 and 0.0 <= y < 100_000.0


@pytest.mark.parametrize("square", ["", "54SIE", "99SUE", "32UAU", "hello"])
def test_squares_that_do_not_exist_are_refused(square):
    with pytest.raises(SemlocError, match="MGRS square"):
        grid_of_mgrs(square)


def _map_file(tmp_path, local: bool, info: str = "", code: str = ""):
    """A stop line of two nodes east and north of TOKYO, in degrees, and in MGRS metres where asked for."""
    lat, lon = TOKYO[0] + np.array([0.0, 1e-4]), TOKYO[1] + np.array([0.0, 1e-4])
    x, y = Transformer.from_crs("EPSG:4326", "EPSG:32654", always_xy=True).transform(lon, lat)
    nodes = ""
    for i in range(2):
        tags = f"<tag k='ele' v='{20.0 + i}'/>"
        tags += f"<tag k='local_x' v='{x[i] - 3e5}'/><tag k='local_y' v='{y[i] - 39e5}'/>" if local else ""
        tags += f"<tag k='mgrs_code' v='{code}'/>" if code else ""
        nodes += f"<node id='{i + 1}' lat='{lat[i]}' lon='{lon[i]}'>{tags}</node>"
    way = "<way id='9'><nd ref='1'/><nd ref='2'/><tag k='type' v='stop_line'/></way>"
    path = tmp_path / "lanelet2_map.osm"
    path.write_text(f"<osm>{nodes}{way}</osm>")
    if info:
        (tmp_path / "map_projector_info.yaml").write_text(info)
    grid = np.column_stack([x - 3e5, y - 39e5, [20.0, 21.0]])
    return path, grid, enu_from_wgs84(lat, lon, np.array([20.0, 21.0]), GeoOrigin(*TOKYO, 20.0))


MGRS = "projector_type: MGRS\nvertical_datum: WGS84\nmgrs_grid: 54SUE\n"


@pytest.mark.parametrize(("info", "code"), [(MGRS, ""), ("", "54SUE8957842301")])
def test_mgrs_metres_stay_unless_a_place_is_asked_for(tmp_path, info, code):
    path, grid, enu = _map_file(tmp_path, True, info, code)
    road = read_lanelet2(path)
    np.testing.assert_allclose(road.elements[0].points, grid, atol=1e-6)
    assert road.frame == "MGRS 54SUE" and road.origin is None
    placed = read_lanelet2(path, GeoOrigin(*TOKYO, 20.0))
    # The way over the grid must undo 0.7 degrees of convergence: within 1 mm of the degrees.
    np.testing.assert_allclose(placed.elements[0].points, enu, atol=1e-3)


def test_degrees_go_to_the_grid_that_the_projector_info_names(tmp_path):
    path, grid, _ = _map_file(tmp_path, False, MGRS)
    np.testing.assert_allclose(read_lanelet2(path).elements[0].points, grid, atol=1e-6)


def _about(kind: str, more: str = "") -> str:
    place = f"map_origin:\n  latitude: {TOKYO[0]}\n  longitude: {TOKYO[1]}\n  altitude: 20.0\n"
    return f"projector_type: {kind}\nvertical_datum: WGS84\n{place}{more}"


def test_projectors_about_an_origin(tmp_path):
    path, grid, enu = _map_file(tmp_path, False, _about("LocalCartesian"))
    road = read_lanelet2(path)
    np.testing.assert_allclose(road.elements[0].points, enu, atol=1e-9)
    assert road.origin == GeoOrigin(*TOKYO, 20.0)
    path, grid, enu = _map_file(tmp_path, False, _about("LocalCartesianUTM"))
    np.testing.assert_allclose(read_lanelet2(path).elements[0].points, grid - grid[0], atol=1e-6)
    path, grid, enu = _map_file(tmp_path, False, _about("TransverseMercator", "scale_factor: 1.0\n"))
    np.testing.assert_allclose(read_lanelet2(path).elements[0].points, enu, atol=1e-3)


@pytest.mark.parametrize(
    ("info", "message"),
    [
        ("projector_type: Gauss\nmap_origin: {latitude: 1, longitude: 2}", "projector_type 'Gauss'"),
        ("projector_type: MGRS", "MGRS square ''"),
        ("projector_type: LocalCartesian", "expected latitude and longitude"),
        ("projector_type: LocalCartesian\nmap_origin: {latitude: 100, longitude: 2}", "expected a place on the earth"),
        ("[1, 2", "not valid YAML"),
        ("5", "expected projector_type"),
    ],
)
def test_broken_projector_info_is_refused(tmp_path, info, message):
    path, _, _ = _map_file(tmp_path, False, info)
    with pytest.raises(SemlocError, match=message):
        read_lanelet2(path)


def test_plain_roads_of_openstreetmap_are_named(tmp_path, caplog):
    path, _, _ = _map_file(tmp_path, False)
    path.write_text(path.read_text().replace("k='type' v='stop_line'", "k='highway' v='residential'"))
    with pytest.raises(SemlocError, match="1 plain OpenStreetMap roads without markings"):
        read_map(path)
    assert "plain OpenStreetMap" in caplog.text


@pytest.fixture(scope="module")
def karlsruhe(data_dir):
    path = data_dir / "maps_lanelet2_karlsruhe" / "lanelet2_maps" / "res" / "mapping_example.osm"
    if not path.is_file():
        pytest.skip(f"no {path.name} in {data_dir}")
    return path


def _library(path):
    lanelet2 = pytest.importorskip("lanelet2")
    projector = lanelet2.projection.LocalCartesianProjector(lanelet2.io.Origin(*ORIGIN))
    return lanelet2.io.loadRobust(str(path), projector)


@pytest.mark.data
def test_lengths_of_every_type_agree_with_the_library(karlsruhe):
    """Lines that are not laid out as dashes or doubles have the length of their linestring, to 1 mm in 100 m."""
    library, _ = _library(karlsruhe)
    mine: dict[str, float] = collections.defaultdict(float)
    theirs: dict[str, float] = collections.defaultdict(float)
    for element in read_map(karlsruhe, ORIGIN).elements:
        if element.style != "dashed" and element.id.isdigit():
            kind = element.attributes["type"]
            points = library.lineStringLayer[int(element.id)]
            flat = np.array([[p.x, p.y] for p in points])
            theirs[kind] += float(np.linalg.norm(np.diff(flat, axis=0), axis=1).sum())
            ring = element.points[[*range(len(element.points)), 0]] if element.closed else element.points
            mine[kind] += float(np.linalg.norm(np.diff(ring[:, :2], axis=0), axis=1).sum())
    assert set(theirs) >= {"line_thin", "line_thick", "stop_line", "curbstone", "zebra_marking", "traffic_sign"}
    for kind, length in theirs.items():
        assert mine[kind] == pytest.approx(length, rel=1e-5, abs=1e-3), kind


@pytest.mark.data
def test_a_written_map_is_read_by_the_library_and_comes_back(karlsruhe, tmp_path):
    road = read_map(karlsruhe, ORIGIN)
    write_lanelet2(road, tmp_path / "again.osm")
    library, errors = _library(tmp_path / "again.osm")
    assert len(library.lineStringLayer) == len(road.elements) and not errors
    again = read_map(tmp_path / "again.osm")
    assert again.origin == ORIGIN and again.name == road.name
    for one, other in zip(road.elements, again.elements, strict=True):
        assert np.abs(one.points - other.points).max() < 1e-4, "no heights: a line of sight is cut elsewhere"
        for field in ("id", "label", "style", "width_m", "true_ends", "has_height", "closed", "attributes"):
            assert getattr(one, field) == getattr(other, field), field
    assert len(library.regulatoryElementLayer) == 7, "six traffic lights and a speed limit; priorities need lanelets"


def test_every_class_comes_back_from_a_map_without_a_place(tmp_path):
    box = np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
    plate = np.array([[0.0, 0.3, 2.0], [0.0, -0.3, 2.0], [0.0, -0.3, 2.6], [0.0, 0.3, 2.6]])
    axis = np.array([[3.0, 3.0, 0.0], [3.0, 3.1, 5.0]])
    elements = [
        MapElement("sign", ElementClass.SIGN, plate, closed=True, shape="circle", normal=np.array([-1.0, 0.0, 0.0])),
        MapElement("light", ElementClass.TRAFFIC_LIGHT, axis, width_m=0.4),
        MapElement("pole", ElementClass.POLE, axis, radius_m=0.1, radius_top_m=0.05),
        MapElement("cone", ElementClass.CONE, axis, radius_m=0.2, radius_top_m=0.04),
        MapElement("dash", ElementClass.LANE_MARKING, axis, width_m=0.15, style="dashed", true_ends=(True, False)),
        MapElement("idea", ElementClass.LANE_MARKING, axis, style="virtual"),
        MapElement("rail", ElementClass.GUARDRAIL, axis, height_m=0.75),
        MapElement("note", ElementClass.CURB, axis, attributes={"a": 'say "<&>" \\ 日本', "n": 3}),
        *(MapElement(f"box {label}", label, box, closed=True, height_m=1.0) for label in ElementClass if label > 1),
    ]
    road = SemanticMap(tuple(elements), None, "all <classes>", {}, "a frame")
    write_lanelet2(road, tmp_path / "all.osm")
    again = read_map(tmp_path / "all.osm")
    assert again.name == "all <classes>" and again.frame == "a frame" and again.origin is None
    for one, other in zip(elements, again.elements, strict=True):
        np.testing.assert_allclose(one.points, other.points, atol=2e-6)
        for field in ("id", "label", "style", "shape", "width_m", "radius_m", "radius_top_m", "height_m", "closed"):
            assert getattr(one, field) == getattr(other, field), (one.id, field)
        assert one.true_ends == other.true_ends and dict(one.attributes) == dict(other.attributes)
    # Other programs see the lower edge of a sign from the left to the right of who reads it.
    text = (tmp_path / "all.osm").read_text()
    first = text.index("local_y")
    assert 'k="local_y" v="0.300000"' in text[first - 3 : first + 40]
