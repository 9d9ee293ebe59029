"""The Lanelet2 reader against the lanelet2 library, and Autoware's dialect on small files."""

import collections

import numpy as np
import pytest
import shapely

from semloc_jax.maps import GeoOrigin, Lanelet2Style, read_map, write_geojson
from semloc_jax.maps.elements import UPRIGHT_CLASSES
from semloc_jax.maps.io.lanelet2 import read_lanelet2
from semloc_jax.structs import ElementClass

ORIGIN = GeoOrigin(49.0065, 8.4353, 0.0)


@pytest.fixture(scope="module")
def karlsruhe(data_dir):
    path = data_dir / "maps_lanelet2_karlsruhe" / "lanelet2_maps" / "res" / "mapping_example.osm"
    if not path.is_file():
        pytest.skip(f"no {path.name} in {data_dir}")
    return path


@pytest.fixture(scope="module")
def oracle(karlsruhe):
    lanelet2 = pytest.importorskip("lanelet2")
    projector = lanelet2.projection.LocalCartesianProjector(lanelet2.io.Origin(*ORIGIN))
    lines, _ = lanelet2.io.loadRobust(str(karlsruhe), projector)
    return {
        str(line.id): (dict(line.attributes), np.array([[p.x, p.y, p.z] for p in line]))
        for line in lines.lineStringLayer
    }


@pytest.fixture(scope="module")
def road(karlsruhe):
    return read_map(karlsruhe, origin=ORIGIN)


def _ways_of(road):
    """Elements by the way they came from."""
    ways = collections.defaultdict(list)
    for element in road.elements:
        ways[element.id.split("_")[0].rstrip("LR")].append(element)
    return ways


def test_every_visible_way_of_the_library_is_here_and_no_other(road, oracle):
    visible = {"line_thin", "line_thick", "stop_line", "zebra_marking", "pedestrian_marking", "bike_marking"}
    visible |= {"curbstone", "guard_rail", "traffic_sign", "traffic_light", "symbol"}
    expected = {way for way, (tags, _) in oracle.items() if tags.get("type") in visible}
    assert set(_ways_of(road)) == expected
    assert len(oracle) == 1140
    left_out = collections.Counter(tags.get("type") for tags, _ in oracle.values())
    assert {k: left_out[k] for k in ("keepout", "wall", "fence", "rail", "zig-zag")} == {
        k: v for k, v in road.skipped.items() if k != "without type"
    }


def test_points_agree_with_the_library_within_a_millimetre(road, oracle):
    compared = 0
    for element in road.elements:
        if element.id not in oracle or element.closed:
            continue
        points = oracle[element.id][1]
        if len(points) == len(element.points):
            assert np.abs(points[:, :2] - element.points[:, :2]).max() < 1e-3
            compared += len(points)
    assert compared > 1000


def test_dashes_lie_on_their_line_and_fill_their_share(road, oracle):
    style = Lanelet2Style()
    painted = total = 0.0
    for way, parts in _ways_of(road).items():
        tags, points = oracle[way]
        if tags.get("subtype") != "dashed" or tags.get("type") not in ("line_thin", "line_thick"):
            continue
        line = shapely.LineString(points[:, :2])
        for part in parts:
            assert part.style == "dashed" and part.true_ends == (False, False)
            assert shapely.distance(line, shapely.points(part.points[:, :2])).max() < 2e-3
            assert part.length_m <= style.dash_m + 1e-6
        if line.length > 30.0:
            painted, total = painted + sum(part.length_m for part in parts), total + line.length
    assert painted / total == pytest.approx(style.dash_m / (style.dash_m + style.gap_m), abs=0.04)


def test_what_is_assumed_is_written_down(road):
    for element in road.elements:
        assumed = element.attributes.get("assumed", [])
        assert ("dashes" in assumed) == (element.style == "dashed")
        assert ("width" in assumed) == (element.width_m > 0)


def test_regulatory_elements_stay_with_their_ways(road):
    lights = [e for e in road.elements if e.label == ElementClass.TRAFFIC_LIGHT and "regulatory" in e.attributes]
    assert lights
    assert all(entry.startswith("traffic_light:") for e in lights for entry in e.attributes["regulatory"])


def test_things_of_unknown_height_are_kept_but_not_sampled(road):
    upright = [e for e in road.elements if e.label in (ElementClass.SIGN, ElementClass.TRAFFIC_LIGHT)]
    assert len(upright) == 21 and all(e.is_logical and not e.has_height for e in upright)


def _osm(tmp_path, body: str, name="map.osm"):
    path = tmp_path / name
    path.write_text(f"<?xml version='1.0'?><osm generator='VMB'>{body}</osm>")
    return path


def _node(ref, x, y, z=None, lat="", lon=""):
    tags = f"<tag k='local_x' v='{x}'/><tag k='local_y' v='{y}'/>" + (
        f"<tag k='ele' v='{z}'/>" if z is not None else ""
    )
    return f"<node id='{ref}' lat='{lat}' lon='{lon}'>{tags}</node>"


def _way(way_id, refs, **tags):
    nodes = "".join(f"<nd ref='{ref}'/>" for ref in refs)
    texts = "".join(f"<tag k='{key}' v='{value}'/>" for key, value in tags.items())
    return f"<way id='{way_id}'>{nodes}{texts}</way>"


def test_autoware_local_coordinates_go_before_empty_degrees(tmp_path):
    body = _node(1, 100.5, 200.25, 19.5) + _node(2, 110.5, 200.25, 20.5, lat="35.9", lon="139.1")
    body += _way(7, (1, 2), type="line_thin", subtype="solid")
    road = read_lanelet2(_osm(tmp_path, body))
    np.testing.assert_array_equal(road.elements[0].points, [[100.5, 200.25, 19.5], [110.5, 200.25, 20.5]])
    assert road.origin is None and road.elements[0].has_height and road.elements[0].width_m == 0.12


def test_upright_things_of_autoware(tmp_path):
    body = _node(1, 0, 0, 5) + _node(2, 0, -1.2, 5) + _node(3, 4, 4, 0) + _node(4, 4.05, 4, 6) + _node(5, 9, 9, 0)
    body += _way(10, (1, 2), type="traffic_light", subtype="red_yellow_green", height="0.45")
    body += _way(11, (1, 2), type="traffic_sign", subtype="stop_sign", height="0.6")
    body += _way(12, (4, 3), type="pole", radius="0.08")
    body += _way(13, (3, 5), type="line_thick", subtype="solid")
    light, sign, pole, line = read_lanelet2(_osm(tmp_path, body)).elements
    np.testing.assert_allclose(light.points, [[0, -0.6, 5], [0, -0.6, 5.45]])
    assert light.width_m == pytest.approx(1.2)
    assert sign.closed and sign.points[:, 2].max() == pytest.approx(5.6)
    # Left at y = 0, right at y = -1.2: whoever reads it stands west of it and looks east.
    np.testing.assert_allclose(sign.normal, [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(pole.points, [[4, 4, 0], [4.05, 4, 6]])
    assert (pole.radius_m, line.width_m) == (0.08, 0.25)


def test_double_lines_have_two_strokes_left_first(tmp_path):
    body = _node(1, 0, 0, 0) + _node(2, 40, 0, 0)
    body += _way(20, (1, 2), type="line_thin", subtype="solid_dashed", width="0.1")
    parts = read_lanelet2(_osm(tmp_path, body), style=Lanelet2Style(double_gap_m=0.2)).elements
    solid, bars = parts[0], parts[1:]
    assert solid.style == "solid" and np.allclose(solid.points[:, 1], 0.15)
    assert len(bars) == 4 and all(np.allclose(bar.points[:, 1], -0.15) and bar.width_m == 0.1 for bar in bars)
    np.testing.assert_allclose([bar.points[0, 0] for bar in bars], [3, 12, 21, 30])
    assert all(bar.length_m == pytest.approx(3.0) for bar in bars)


def test_areas_slots_and_deleted_ways(tmp_path):
    corners = [(0, 0), (2, 0), (2, 5), (0, 5)]
    body = "".join(_node(i + 1, x, y, 0) for i, (x, y) in enumerate(corners)) + _node(8, 0, 0, 0)
    body += _way(30, (1, 2, 3, 4, 1), type="symbol", subtype="arrow")
    body += _way(31, (1, 4), type="parking_space", width="2.5")
    body += _way(32, (1, 2), type="symbol", subtype="30") + _way(33, (1, 2), type="virtual")
    body += "<way id='34' action='delete'><nd ref='1'/><nd ref='2'/><tag k='type' v='stop_line'/></way>"
    arrow, slot, text = read_lanelet2(_osm(tmp_path, body)).elements
    assert arrow.closed and len(arrow.points) == 4 and arrow.shape == "arrow" and not arrow.is_logical
    assert shapely.Polygon(slot.points[:, :2]).area == pytest.approx(12.5) and slot.is_logical
    assert text.style == "virtual"


def test_a_lanelet2_map_keeps_its_meaning_as_geojson(road, tmp_path):
    some = road.with_elements([e for i, e in enumerate(road.elements) if i % 20 == 0 or e.label in UPRIGHT_CLASSES])
    write_geojson(some, tmp_path / "m.geojson")
    again = read_map(tmp_path / "m.geojson")
    assert len(again.elements) == len(some.elements) > 100
    for one, other in zip(some.elements, again.elements, strict=True):
        assert (one.label, one.style, one.true_ends, one.width_m) == (
            other.label,
            other.style,
            other.true_ends,
            other.width_m,
        )
        assert np.abs(one.points - other.points).max() < 1e-3


def test_relations_that_refer_to_each_other_end(tmp_path):
    body = _node(1, 0, 0, 0) + _node(2, 9, 0, 0) + _way(40, (1, 2), type="stop_line", width="0.3")
    for one, other in ((50, 51), (51, 50)):
        body += f"<relation id='{one}'><member type='relation' ref='{other}' role='refers'/>"
        body += "<member type='way' ref='40' role='ref_line'/><tag k='type' v='regulatory_element'/></relation>"
    (stop,) = read_lanelet2(_osm(tmp_path, body)).elements
    assert stop.width_m == 0.3 and stop.attributes["regulatory"] == [":50:ref_line", ":51:ref_line"]
