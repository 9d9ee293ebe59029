"""The native store: exact round trips, GDAL as a witness, and a map of 1,000 km."""

import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.maps import MapElement, SemanticMap, read_map
from semloc_jax.maps.io.geopackage import StoredMap, write_geopackage
from semloc_jax.maps.io.geopackage.schema import GuardedConnection
from semloc_jax.structs import ElementClass
from tests.counting import num_calls
from tests.maps.io.town import town

ROOT = Path(__file__).parents[3]


def _counted(monkeypatch) -> list[tuple[str, int]]:
    """Every query that a GeoPackage is asked from now on, with the number of rows that it gives."""
    asked: list[tuple[str, int]] = []

    def counted(read):
        def rows_of(self, query, values=()):
            rows = list(read(self, query, values))
            asked.append((query, len(rows)))
            return rows

        return rows_of

    for name in ("ask", "walk"):
        monkeypatch.setattr(GuardedConnection, name, counted(getattr(GuardedConnection, name)))
    return asked


def _same(one: MapElement, other: MapElement) -> bool:
    fields = ("id", "label", "closed", "width_m", "radius_m", "radius_top_m", "height_m", "style", "shape")
    fields += ("true_ends", "has_height", "attributes")
    normals = [e.normal if e.normal is not None else np.zeros(3) for e in (one, other)]
    return (
        all(getattr(one, name) == getattr(other, name) for name in fields)
        and np.array_equal(one.points, other.points)
        and np.array_equal(*normals)
    )


@pytest.fixture(scope="module")
def stored_road(road_dir, tmp_path_factory):
    road = read_map(road_dir / "map.geojson")
    path = tmp_path_factory.mktemp("store") / "road.gpkg"
    write_geopackage(road, path)
    return road, path


@pytest.mark.data
def test_every_field_of_every_element_comes_back_exactly(stored_road):
    road, path = stored_road
    again = read_map(path)
    assert isinstance(again, StoredMap) and again.origin == road.origin and again.name == road.name
    assert len(again.elements) == len(road.elements)
    assert all(_same(one, other) for one, other in zip(road.elements, again.elements, strict=True))
    assert again.labels == road.labels
    fewer = again.with_elements(again.elements[:3])
    assert type(fewer) is SemanticMap and fewer.origin == road.origin and len(fewer.query([0.0, 0.0], 1e4).elements) > 2


@pytest.mark.data
def test_queries_and_ground_are_those_of_the_map_in_memory(stored_road):
    road, path = stored_road
    again = read_map(path)
    for element in road.elements[:: len(road.elements) // 25]:
        place = element.points[0]
        here, there = road.query(place, 40.0, 0.3), again.query(place, 40.0, 0.3)
        assert [e.id for e in here.elements] == [e.id for e in there.elements]
        assert all(_same(a, b) for a, b in zip(here.elements, there.elements, strict=True))
        np.testing.assert_array_equal(here.origin_map, there.origin_map)
        pose, stored = road.road_pose(*place[:2], 0.3), there.ground.road_pose(*place[:2], 0.3)
        np.testing.assert_allclose(pose, stored, atol=1e-9)


@pytest.mark.data
def test_a_place_is_read_from_the_file_once(stored_road, monkeypatch):
    road, path = stored_road
    places = [e.points[0, :2] for e in road.elements[:: len(road.elements) // 40]]
    asked = _counted(monkeypatch)
    stored = read_map(path)
    for _ in range(2):
        asked.clear()
        for place in places:
            stored.query(place, 50.0)
    # The second time only the R-tree is asked, once for each place.
    assert len(asked) == len(places) and not any("FROM elements" in query for query, _ in asked)


@pytest.mark.data
def test_gdal_reads_the_layer(stored_road):
    pyogrio = pytest.importorskip("pyogrio")
    road, path = stored_road
    info = pyogrio.read_info(path, layer="elements")
    assert info["features"] == len(road.elements) and info["capabilities"]["fast_spatial_filter"]
    assert "Transverse_Mercator" in info["crs"]
    box = (*road.elements[0].points[0, :2] - 5.0, *road.elements[0].points[0, :2] + 5.0)
    _, _, _, (ids,) = pyogrio.raw.read(path, layer="elements", columns=["id"], bbox=tuple(box))
    assert road.elements[0].id in ids and len(ids) < len(road.elements)


@pytest.fixture(scope="module", params=[100, pytest.param(1000, marks=pytest.mark.slow)], ids="{} km".format)
def large_map(tmp_path_factory, request):
    path = tmp_path_factory.mktemp("store") / "town.gpkg"
    subprocess.run([sys.executable, "-m", "tests.maps.io.town", str(request.param), str(path)], check=True, cwd=ROOT)
    return path, request.param


def test_a_large_map_is_opened_without_its_elements_and_read_around_the_places_only(large_map, monkeypatch):
    path, num_km = large_map
    rows = num_km // 32
    places = [np.array([1000.0 * (7 * i % 31) + 10.0 * i, 400.0 * (i % rows)]) for i in range(60)]
    asked = _counted(monkeypatch)
    town = read_map(path)
    assert sum(num_rows for _, num_rows in asked) < 100, "opening reads tables of the file, no element"
    for place in places:
        asked.clear()
        found = town.query(place, 100.0).elements
        # The square around the place holds a little more than the circle.
        assert sum(num_rows for query, num_rows in asked if "FROM elements" in query) <= 2 * len(found) + 20
    assert len(found) > 20
    assert path.stat().st_size < 40e3 * num_km


def test_the_work_of_a_query_does_not_grow_with_the_file(tmp_path):
    """Eight times the road in the file: the same calls for the same place."""
    calls = []
    for num_km in (8, 64):
        path = tmp_path / f"{num_km}.gpkg"
        write_geopackage(town(num_km), path)
        stored = read_map(path)
        stored.query([500.0, 0.0], 100.0)
        calls.append(num_calls(lambda stored=stored: stored.query([500.0, 0.0], 100.0)))
    assert calls[1] < 1.2 * calls[0]


def test_rows_name_the_elements_of_a_large_map_without_reading_it(large_map, monkeypatch):
    """What a tracker keeps for each element of the map it finds by row."""

    def refuse(self):
        raise AssertionError("the whole map is read")

    monkeypatch.setattr(StoredMap, "elements", property(refuse))
    path, num_km = large_map
    stored = read_map(path)
    assert stored.num_elements == num_km * (2 * 10 + 83 + 20)
    found = stored.query([5005.0, 800.0], 50.0).elements
    rows = stored.rows_of(element.id for element in found)
    assert [stored.element_at(int(row)).id for row in rows] == [element.id for element in found]
    assert len(found) > 10 and rows.max() < stored.num_elements


def test_a_map_without_a_place_on_the_earth_and_odd_elements(tmp_path):
    point = MapElement("point", ElementClass.SIGN, np.array([[1.0, 2.0, 3.0]]), normal=np.array([0.0, 1.0, 0.0]))
    pair = MapElement("pair", ElementClass.CURB, np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), closed=True)
    flat = MapElement("flat", ElementClass.STOP_LINE, np.array([[0.0, 5.0, 0.0], [1.0, 5.0, 0.0]]), has_height=False)
    road = SemanticMap((point, pair, flat), None, "odd", {"tram": 3}, "somewhere")
    write_geopackage(road, tmp_path / "odd.gpkg")
    again = read_map(tmp_path / "odd.gpkg")
    assert again.origin is None and again.skipped == {"tram": 3} and again.frame == "somewhere"
    assert all(_same(one, other) for one, other in zip(road.elements, again.elements, strict=True))


def test_layers_of_other_programs_in_degrees(tmp_path):
    """Written by GDAL: a layer with our property names, and one named after its class."""
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    path = tmp_path / "other.gpkg"
    lines = shapely.to_wkb([shapely.LineString([(11.6, 48.1), (11.601, 48.1)])], output_dimension=2)
    fields = {"class": np.array(["lane_solid"], dtype=object), "width": np.array([0.15])}
    values = {"fields": list(fields), "field_data": list(fields.values()), "crs": "EPSG:4326"}
    pyogrio.raw.write(path, lines, layer="paint", driver="GPKG", geometry_type="LineString", **values)
    poles = shapely.to_wkb([shapely.Point(11.6, 48.1, 5.0)], output_dimension=3)
    values = {"fields": ["height", "radius"], "field_data": [np.array([6.0]), np.array([0.1])], "crs": "EPSG:4326"}
    pyogrio.raw.write(path, poles, layer="pole", driver="GPKG", geometry_type="Point Z", append=True, **values)
    road = read_map(path)
    line, pole = road.elements
    # A thousandth of a degree of longitude at 48.1 N.
    assert line.length_m == pytest.approx(74.47, abs=0.02) and line.width_m == 0.15 and not line.has_height
    assert pole.length_m == pytest.approx(6.0) and pole.radius_m == 0.1
    assert road.origin is not None and road.origin.lat_deg == 48.1


def _broken(tmp_path, statement: str):
    path = tmp_path / "broken.gpkg"
    write_geopackage(town(1), path)
    with sqlite3.connect(path) as connection:
        for name in ("ST_IsEmpty", "ST_MinX", "ST_MaxX", "ST_MinY", "ST_MaxY"):
            connection.create_function(name, 1, lambda blob: 0)
        connection.executescript(statement)
    connection.close()
    return path


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT 'name' key, i value FROM n"


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("DROP TABLE semloc_map", "reference system NONE:100001 is unknown"),
        (f"DROP TABLE semloc_map; CREATE VIEW semloc_map AS {ENDLESS}", "is unknown"),
        ("DELETE FROM semloc_map WHERE key = 'origin'", "incomplete"),
        ("UPDATE elements SET geom = x'00'", "no GeoPackage geometry"),
        ("UPDATE elements SET attributes = '[1]'", "cannot be read"),
        ("UPDATE elements SET class = 'tram'", "class 'tram'"),
        ("DROP TABLE elements; DROP TABLE semloc_map", "is no table; expected a plain layer"),
    ],
)
def test_broken_stores_are_refused_in_one_line(tmp_path, statement, message):
    path = _broken(tmp_path, statement)
    with pytest.raises(SemlocError, match=message) as caught:
        assert read_map(path).elements
    assert "\n" not in str(caught.value)


def test_text_with_the_wrong_ending_is_refused(tmp_path):
    (tmp_path / "no.gpkg").write_text("not a database")
    with pytest.raises(SemlocError, match="expected a GeoPackage"):
        read_map(tmp_path / "no.gpkg")
