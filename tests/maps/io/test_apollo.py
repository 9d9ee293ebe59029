"""Apollo HD maps in text form: everything at its place, boundaries of neighbours once, grids that are not true."""

import numpy as np
import pyproj
import pytest

from semloc_jax.cli.main import OK, main
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import enu_from_wgs84
from semloc_jax.maps import GeoOrigin, read_lane_centers, read_map
from semloc_jax.maps.io.text_format import stream_fields
from semloc_jax.structs import ElementClass
from tests.counting import num_calls
from tests.maps.io.apollo_file import ABOUT, DIVIDER, EAST, MAP, NORTH, UTM, boundary, curve, lane, write
from tests.maps.io.mutations import COUNTS, break_often


@pytest.fixture
def road(tmp_path):
    return read_map(write(tmp_path))


def of(found, label, style=None):
    return [e for e in found.elements if e.label == label and (style is None or e.style == style)]


def expected(road, x, y):
    lon, lat = pyproj.Transformer.from_crs("EPSG:32610", "EPSG:4326", always_xy=True).transform(EAST + x, NORTH + y)
    return enu_from_wgs84(lat, lon, road.origin.alt_m, road.origin)[:2]


def test_every_kind_of_thing_is_at_its_place(road):
    (crossing,) = of(road, ElementClass.CROSSWALK)
    np.testing.assert_allclose(crossing.points[2, :2], expected(road, 64, 3.5), atol=1e-3)
    assert crossing.closed and not crossing.has_height and len(crossing.points) == 4
    (light,) = of(road, ElementClass.TRAFFIC_LIGHT)
    assert light.width_m == pytest.approx(0.4) and light.style == "" and light.has_height
    assert np.ptp(light.points[:, 2]) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(light.points[0, :2], expected(road, 70, -4.8), atol=1e-3)
    (slot,) = of(road, ElementClass.PARKING_SLOT)
    entrance = np.sort(slot.points[:2, 1])
    np.testing.assert_allclose(entrance.mean(), expected(road, 9, 7)[1], atol=1e-3)  # cars drive in northwards
    assert road.skipped == {"speed_bump": 1}
    assert "utm" in road.frame and road.origin is not None


def test_a_stop_line_that_sign_and_light_share_is_there_once(road):
    (line,) = of(road, ElementClass.STOP_LINE)
    assert line.length_m == pytest.approx(3.5 / 0.9997, abs=0.002) and line.attributes["assumed"] == ["width"]


def test_boundaries_are_painted_as_their_types_say(road):
    solid = of(road, ElementClass.LANE_MARKING, "solid")
    assert [e.id for e in solid] == ["a_leftL", "a_leftR", "b_right"]
    assert {e.attributes["color"] for e in solid[:2]} == {"yellow"}
    assert solid[2].length_m == pytest.approx(60.0, rel=1e-3)
    (curb,) = of(road, ElementClass.CURB)
    assert curb.length_m == pytest.approx(40.0, rel=1e-3)
    bars = of(road, ElementClass.LANE_MARKING, "dashed")
    assert len(bars) == 17 and all(e.length_m == pytest.approx(2.0, rel=1e-3) for e in bars)  # 100 m, every 6 m
    assert len({e.attributes["lane"] for e in bars}) == 1, "neighbours list it 5 cm apart; it is there once"
    assert {e.id for e in of(road, ElementClass.LANE_MARKING, "virtual")} == {"c_left", "c_right"}


def test_a_header_that_names_another_grid_is_not_believed(tmp_path, road, caplog):
    """As in the first public maps: a grid about the middle of the map, and UTM coordinates."""
    found = read_map(write(tmp_path, ABOUT))
    assert "taken as EPSG:32610" in caplog.text
    assert found.origin == road.origin
    for one, other in zip(found.elements, road.elements, strict=True):
        np.testing.assert_allclose(one.points, other.points, atol=1e-6)
    kept = read_map(write(tmp_path, "+proj=utm +zone=99"))
    assert kept.origin is None and kept.extent[0, 0] > 5e5
    with pytest.raises(SemlocError, match="cannot be placed at an origin"):
        read_map(write(tmp_path, ""), GeoOrigin(37.4, -122.0))


def test_convert_and_inspect_know_the_format(tmp_path, capsys):
    path = write(tmp_path)
    assert main(["convert", str(path), str(tmp_path / "map.gpkg")]) == OK
    assert len(read_map(tmp_path / "map.gpkg").elements) == len(read_map(path).elements)
    assert "left out when the map was read: 1 speed_bump" in capsys.readouterr().out
    assert main(["inspect", str(path)]) == OK
    assert "crosswalk" in capsys.readouterr().out.lower()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no element that a camera could see"),
        ("frame: 1", "expected the text form of an Apollo HD map"),
        ("just words", "a value of just is expected"),
        ("7.5 0", r"\('0' at byte 4, where a value of 7.5"),
        ("lane {", "ends in the middle"),
        ("lane { id { id: 'a' } } }", "where a name is expected"),
        ("lane " + "{ a " * 100, "nested deeper"),
        ('lane { left_boundary { curve { segment { line_segment { point { x: "q" y: 1 } } } } } }', "x is 'q'"),
        ("lane { left_boundary { curve { segment { line_segment { point { y: 1 } } } } } }", "x is 'None'"),
        ("\x01", "is the file complete"),
        (lane("a", boundary("left", 3.5, [(0, "DOTTED_WHITE")]).replace(f"x: {EAST + 100}", "x: 9e7"), ""), "km long"),
    ],
)
def test_broken_maps_are_one_line(tmp_path, text, message):
    with pytest.raises(SemlocError, match=message) as caught:
        read_map(write(tmp_path, text=text))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("count", COUNTS)
def test_broken_copies_are_read_or_refused(tmp_path, count):
    assert break_often(write(tmp_path).read_bytes(), count, lambda text: reread(tmp_path / "broken.txt", text)) > 0


def reread(path, content):
    path.write_bytes(content)
    read_map(path)


def test_fields_of_any_form_are_read_in_linear_time(tmp_path):
    path = tmp_path / "m.txt"
    path.write_text("a: [1, -2.5e-3, inf]; b { c: 'x\"y' d < e: TRUE > }, # no more\nb {}")
    assert list(stream_fields(path)) == [
        ("a", "1"), ("a", "-2.5e-3"), ("a", "inf"), ("b", {"c": ['x"y'], "d": [{"e": ["TRUE"]}]}), ("b", {}),
    ]  # fmt: skip

    def calls(count):
        path.write_text("lane { point { x: 1.5 y: 2.5 } }\n" * count)
        return num_calls(lambda: sum(1 for _ in stream_fields(path)))

    few, many = calls(500), calls(2000)
    assert many == pytest.approx(4 * few, rel=0.02)


def test_lanes_run_half_way_between_their_boundaries_in_their_direction(tmp_path, road):
    walk = lane("w", "type: SIDEWALK " + boundary("left", 9.0, DIVIDER), boundary("right", 7.0, DIVIDER))
    back = lane("d", "direction: BACKWARD " + boundary("left", 40.0, DIVIDER), boundary("right", 36.0, DIVIDER))
    only = f'lane {{ id {{ id: "e" }} central_curve {{ {curve((0, 60), (100, 60))} }} }}\n'
    path = write(tmp_path, UTM, MAP + walk + back + only)
    a, b, c, d, e = read_lane_centers(path, road.origin)
    for found, y in ((a, 1.75), (b, -1.725), (c, 18.0), (e, 60.0)):
        np.testing.assert_allclose(found[0, :2], expected(road, 0, y), atol=1e-3)
        np.testing.assert_allclose(found[-1, :2], expected(road, 100, y), atol=1e-3)
    np.testing.assert_allclose(d[0, :2], expected(road, 100, 38.0), atol=1e-3)
    np.testing.assert_allclose(d[-1, :2], expected(road, 0, 38.0), atol=1e-3)
