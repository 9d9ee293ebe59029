"""OpenDRIVE against pyxodr, closed forms and numbers read off the files."""

import collections
import warnings

import numpy as np
import pytest
import shapely
from scipy.integrate import quad

from semloc_jax.errors import SemlocError
from semloc_jax.maps import GeoOrigin, read_map
from semloc_jax.maps.io.opendrive import read_opendrive, read_roads
from semloc_jax.structs import ElementClass


@pytest.fixture(scope="module")
def folder(data_dir):
    found = data_dir / "maps_opendrive_esmini" / "resources" / "xodr"
    if not found.is_dir():
        pytest.skip(f"no OpenDRIVE files in {data_dir}")
    return found


def _network(path):
    network = pytest.importorskip("pyxodr.road_objects.network")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {str(road.id): road for road in network.RoadNetwork(str(path), 0.1, set()).get_roads()}


QUICK = ["circle_300m", "fabriksgatan", "soderleden", "two_plus_one"]
LONG = "multi_intersections crest-curve curve_r100 curves curves_elevation e6mini e6mini-lht jolengatan".split()
LONG += "straight_500m straight_500m_roadmarks straight_500m_signs striaghtAndCurves tunnels velodrome".split()
LONG += ["fabriksgatan_traffic_lights"]


def _slow(names):
    return [pytest.param(name, marks=pytest.mark.slow) for name in names]


@pytest.mark.data
def test_no_file_is_left_out(folder):
    assert {path.stem for path in folder.glob("*.xodr")} == {*QUICK, *LONG, "parking_demo"}


@pytest.mark.data
@pytest.mark.parametrize("name", ["parking_demo", *QUICK, *_slow(LONG)])
def test_all_files_are_read_and_hold_paint(folder, name):
    road_map = read_map(folder / f"{name}.xodr")
    painted = [e for e in road_map.elements if e.is_painted]
    assert painted and np.isfinite(road_map.extent).all()
    assert len({e.id for e in road_map.elements}) == len(road_map.elements)


@pytest.mark.data
@pytest.mark.parametrize("name", [*QUICK, *_slow(LONG)])
def test_reference_lines_and_lane_borders_agree_with_pyxodr(folder, name):
    """Reference lines within 1 mm (1.1 mm where pyxodr's own 10 cm chords cut a bend), lane borders within 1 cm.

    pyxodr takes normals from finite differences, which turns the first and last half metre of its borders, and it knows
    no banking (velodrome); parking_demo it does not read at all.
    """
    theirs = _network(folder / f"{name}.xodr")
    roads = read_roads(folder / f"{name}.xodr")
    assert len(roads) == len(theirs)
    for road in roads:
        s = road.between(0.0, road.length)
        flat = shapely.LineString(road.locate(s, np.zeros_like(s))[:, :2])
        reference = np.asarray(theirs[road.id].reference_line)[:, :2]
        assert shapely.distance(flat, shapely.points(reference)).max() < 1.1e-3, road.id
        if name == "velodrome":
            continue
        for their_section, section in zip(theirs[road.id].lane_sections, road.sections, strict=True):
            for lane in their_section.lanes:
                line = np.asarray(lane.boundary_line)[5:-5, :2]
                mine = shapely.LineString(road.border(section, lane.id, section.start, section.end)[:, :2])
                assert shapely.distance(mine, shapely.points(line)).max(initial=0.0) < 0.01, (road.id, lane.id)


@pytest.mark.data
def test_banked_lanes_keep_their_width_and_tilt(folder):
    (road,) = read_roads(folder / "velodrome.xodr")
    s = np.array([100.0, 700.0, 800.0])
    middle, edge = road.locate(s, np.zeros(3)), road.locate(s, np.full(3, -9.0))
    np.testing.assert_allclose(np.linalg.norm(edge - middle, axis=1), 9.0, atol=1e-9)
    # 60 degrees in the curves: the right edge of a left curve is high.
    np.testing.assert_allclose(np.degrees(np.arcsin((edge - middle)[:, 2] / 9.0)), [0.0, 60.0, 60.0], atol=1e-6)


@pytest.mark.data
def test_dashes_are_where_the_file_says(folder):
    road_map = read_opendrive(folder / "straight_500m_roadmarks.xodr")
    bars = [e for e in road_map.elements if e.style == "dashed" and abs(e.points[:, 1].mean()) < 0.01]
    starts = sorted(e.points[0, 0] for e in bars)
    # 4 m every 12 m up to 50 m, 4 m every 8 m from 350 m to 400 m.
    expected = [*np.arange(0.0, 50.0, 12.0), *np.arange(350.0, 400.0, 8.0)]
    np.testing.assert_allclose(starts, expected, atol=1e-6)
    lengths = collections.Counter(round(e.length_m, 6) for e in bars)
    assert lengths == {4.0: 10, 2.0: 2}, "the last bar of each stretch is cut where the mark ends"
    assert all(e.width_m == 0.12 and e.true_ends == (True, True) for e in bars)
    doubles = [e for e in road_map.elements if e.style == "solid" and abs(e.points[0, 0] - 100.0) < 1e-6]
    np.testing.assert_allclose(
        sorted(e.points[0, 1] for e in doubles), [-3.37, -2.77, -0.3, 0.3, 2.77, 3.37], atol=1e-6
    )
    late = [e for e in road_map.elements if e.style == "solid" and abs(e.points[0, 0] - 450.0) < 1e-6]
    assert len(late) == 3


@pytest.mark.data
def test_signals_have_size_height_and_face_their_traffic(folder):
    road_map = read_opendrive(folder / "straight_500m_signs.xodr")
    sign = next(e for e in road_map.elements if e.attributes.get("name") == "speed_50_0_0")
    np.testing.assert_allclose([sign.points[:, 2].min(), sign.points[:, 2].max()], [1.7, 2.31], atol=1e-9)
    np.testing.assert_allclose(np.ptp(sign.points[:, 1]), 0.61, atol=1e-9)
    np.testing.assert_allclose(sign.points[:, :2].mean(axis=0), [0.0, 3.57], atol=1e-9)
    np.testing.assert_allclose(sign.normal, [-1.0, 0.0, 0.0], atol=1e-12)
    back = next(e for e in road_map.elements if e.attributes.get("name") == "speed_50_2")
    np.testing.assert_allclose(back.normal, [1.0, 0.0, 0.0], atol=1e-12)
    german = [e for e in road_map.elements if e.attributes.get("country") == "de"]
    assert {e.shape for e in german if e.attributes["type"] == "274"} == {"circle"}
    pole = next(e for e in road_map.elements if e.label == ElementClass.POLE)
    np.testing.assert_allclose(pole.points, [[0.0, 3.57, -0.2], [0.0, 3.57, 2.15]], atol=1e-9)
    assert pole.radius_m == pytest.approx(0.03)


@pytest.mark.data
def test_parking_spaces_crosswalks_lights_and_stop_lines(folder):
    parking = read_opendrive(folder / "parking_demo.xodr")
    slots = [e for e in parking.elements if e.label == ElementClass.PARKING_SLOT]
    assert len(slots) == 62 and all(len(e.points) == 4 for e in slots)
    bars = [e for e in parking.elements if e.label == ElementClass.CROSSWALK and e.width_m == 5.0]
    assert len(bars) == 6 and all(e.length_m == pytest.approx(0.5, abs=1e-6) for e in bars)
    np.testing.assert_allclose(sorted(e.points[0, 1] for e in bars), -2.75 + np.arange(6), atol=1e-6)
    lights = read_opendrive(folder / "fabriksgatan_traffic_lights.xodr")
    boxes = [e for e in lights.elements if e.label == ElementClass.TRAFFIC_LIGHT]
    assert sorted(round(e.length_m, 3) for e in boxes) == [0.55, 0.55, 0.8]
    town = read_opendrive(folder / "multi_intersections.xodr")
    stops = [e for e in town.elements if e.label == ElementClass.STOP_LINE]
    assert len(stops) == 17 and {round(e.length_m, 2) for e in stops} == {3.75, 7.24}
    west = [e for e in stops if abs(e.points[:, 0].mean() - 52.0) < 2.0 and abs(e.points[0, 1] + 15.0) < 1.0]
    assert len(west) == 1, "traffic keeps right, so the stop line south of the junction lies east of the middle"


ROAD = """<OpenDRIVE><header>{header}</header><road id="1" length="{length}" junction="-1">
<planView><geometry s="0" x="{x}" y="{y}" hdg="0" length="{length}">{shape}</geometry></planView>
<elevationProfile><elevation s="0" a="2" b="{grade}" c="0" d="0"/></elevationProfile>
<lateralProfile>{lateral}</lateralProfile>
<lanes><laneSection s="0"><center><lane id="0" type="none"><roadMark sOffset="0" type="{mark}" width="{width}"/></lane>
</center><right><lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection>
</lanes><objects>{objects}</objects></road></OpenDRIVE>"""
PLAIN = {
    "header": "",
    "length": 40.0,
    "x": 0.0,
    "y": 0.0,
    "shape": "<line/>",
    "grade": 0.0,
    "lateral": "",
    "mark": "solid",
    "width": 0.15,
    "objects": "",
}


def _write(tmp_path, **values):
    path = tmp_path / "road.xodr"
    path.write_text(ROAD.format(**PLAIN | values))
    return path


def test_poly3_runs_by_arc_length(tmp_path):
    a, b, c, d = 0.0, 0.1, 0.02, -0.0004
    (road,) = read_roads(_write(tmp_path, shape=f'<poly3 a="{a}" b="{b}" c="{c}" d="{d}"/>'))
    s = np.array([0.0, 7.3, 21.9, 40.0])
    x, y, heading = road.plan.at(s)
    for at, u, v, turn in zip(s, x, y, heading, strict=True):
        length, _ = quad(lambda w: np.hypot(1.0, b + 2 * c * w + 3 * d * w * w), 0.0, u, epsabs=1e-12)
        assert length == pytest.approx(at, abs=1e-9)
        assert v == pytest.approx(b * u + c * u * u + d * u**3, abs=1e-12)
        assert np.tan(turn) == pytest.approx(b + 2 * c * u + 3 * d * u * u, abs=1e-9)


@pytest.mark.parametrize(("p_range", "scale"), [("normalized", 1.0), ("arcLength", 40.0)])
def test_param_poly3_takes_both_ranges(tmp_path, p_range, scale):
    coefficients = f'aU="0" bU="{40 / scale}" cU="0" dU="0" aV="0" bV="0" cV="{3 / scale**2}" dV="{1 / scale**3}"'
    (road,) = read_roads(_write(tmp_path, shape=f'<paramPoly3 pRange="{p_range}" {coefficients}/>'))
    x, y, _ = road.plan.at(np.array([10.0, 40.0]))
    np.testing.assert_allclose(x, [10.0, 40.0], atol=1e-9)
    np.testing.assert_allclose(y, [3 * 0.25**2 + 0.25**3, 4.0], atol=1e-9)


def test_a_clothoid_of_constant_curvature_is_a_circle(tmp_path):
    (road,) = read_roads(_write(tmp_path, shape='<spiral curvStart="0.02" curvEnd="0.02"/>'))
    s = np.linspace(0.0, 40.0, 9)
    x, y, _ = road.plan.at(s)
    np.testing.assert_allclose(x, 50.0 * np.sin(s / 50.0), atol=1e-9)
    np.testing.assert_allclose(y, 50.0 * (1.0 - np.cos(s / 50.0)), atol=1e-9)


def test_grade_shape_and_height(tmp_path):
    lateral = '<shape s="0" t="-5" a="0.1" b="0" c="0" d="0"/><shape s="40" t="-5" a="0.3" b="0" c="0" d="0"/>'
    (road,) = read_roads(_write(tmp_path, grade=0.05, lateral=lateral))
    points = road.locate(np.array([0.0, 20.0]), np.array([-1.0, -1.0]))
    up = np.cos(np.arctan(0.05))
    np.testing.assert_allclose(points[:, 2], [2.0 + 0.1 * up, 3.0 + 0.2 * up], atol=1e-9)


def test_unsaid_dashes_are_called_assumed(tmp_path):
    bars = [e for e in read_opendrive(_write(tmp_path, mark="broken", width=0.0)).elements if e.style == "dashed"]
    assert len(bars) == 5 and all(e.attributes["assumed"] == ["width", "dashes"] for e in bars)
    assert not any(any(e.true_ends) for e in bars)


def test_named_double_lines_begin_on_the_left_of_the_centre(tmp_path):
    parts = [e for e in read_opendrive(_write(tmp_path, mark="solid broken")).elements if e.is_painted]
    assert parts[0].style == "solid" and parts[0].points[0, 1] == pytest.approx(0.135)
    assert all(e.points[0, 1] == pytest.approx(-0.135) for e in parts[1:]) and len(parts) == 6


def test_a_true_georeference_puts_the_map_on_the_earth(tmp_path):
    utm = "<geoReference>+proj=utm +zone=32 +datum=WGS84 +geoidgrids=egm96_15.gtx +units=m</geoReference>"
    # 0.9996 on the central meridian: 40 m of the grid are 40.016 m on the ground.
    road_map = read_opendrive(_write(tmp_path, header=utm, x=499980.0, y=5.4e6))
    assert road_map.origin is not None and road_map.origin.lon_deg == pytest.approx(9.0, abs=1e-3)
    line = next(e for e in road_map.elements if e.style == "solid")
    assert line.length_m == pytest.approx(40.0 / 0.9996, abs=1e-4)
    moved = read_opendrive(_write(tmp_path, header=utm, x=499980.0, y=5.4e6), GeoOrigin(48.75, 9.0))
    assert np.abs(moved.elements[0].points[:, 0]).max() < 21.0


def test_a_georeference_that_cannot_be_true_leaves_the_map_local(tmp_path):
    utm = "<geoReference>+proj=utm +zone=32 +datum=WGS84</geoReference>"
    road_map = read_opendrive(_write(tmp_path, header=utm))
    assert road_map.origin is None and road_map.elements[0].points[-1, 0] == 40.0
    with pytest.raises(SemlocError, match="no geoReference"):
        read_opendrive(_write(tmp_path), GeoOrigin(48.0, 9.0))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"shape": "<arc/>"}, "curvature = ''"),
        ({"shape": '<arc curvature="nan"/>'}, "curvature = 'nan'"),
        ({"shape": "<bezier/>"}, "is bezier; expected one of"),
        ({"shape": '<spiral curvStart="0" curvEnd="9"/>', "length": 9e4}, "turns"),
        ({"length": 1e9}, "length"),
        (
            {"objects": '<object type="pole" s="0" t="0"><repeat s="0" length="1e6" distance="1e-9"/></object>'},
            "expected at least 5 cm",
        ),
    ],
)
def test_numbers_that_no_road_has_are_refused(tmp_path, values, message):
    with pytest.raises(SemlocError) as caught:
        read_opendrive(_write(tmp_path, **values))
    assert message in str(caught.value) and "road 1" in str(caught.value)


BROKEN_END = """<OpenDRIVE><header><geoReference>EPSG:25832</geoReference></header>
<road id="1" length="{length}" junction="-1"><planView>
<geometry s="0" x="696000" y="5346700" hdg="4.4" length="500"><line/></geometry>
<geometry s="{s}" x="{x}" y="{y}" hdg="0.65" length="{last}"><line/></geometry></planView>
<lanes><laneSection s="0"><center><lane id="0" type="none"><roadMark sOffset="0" type="solid" width="0.15"/></lane>
</center></laneSection></lanes></road></OpenDRIVE>"""


@pytest.mark.parametrize("lanes", ["", "<lanes></lanes>"])
def test_a_road_without_lanes_is_no_road_and_stops_no_other(tmp_path, lanes):
    whole = BROKEN_END.format(length=500, s=400, x=696000, y=5346700, last=0)
    start, end = whole.index("<lanes>"), whole.index("</road>")
    bare = whole[:start] + lanes + whole[end:]
    (tmp_path / "bare.xodr").write_text(bare)
    with pytest.raises(SemlocError, match="no element that a camera could see"):
        read_map(tmp_path / "bare.xodr")
    road = whole[whole.index("<road") : whole.index("</OpenDRIVE>")].replace('id="1"', 'id="2"')
    (tmp_path / "both.xodr").write_text(bare.replace("</OpenDRIVE>", f"{road}</OpenDRIVE>"))
    (tmp_path / "one.xodr").write_text(whole[: whole.index("<road")] + road + "</OpenDRIVE>")
    both, one = read_map(tmp_path / "both.xodr"), read_map(tmp_path / "one.xodr")
    assert [e.id for e in both.elements] == [e.id for e in one.elements] != []


def _road_with_a_jump(tmp_path, last):
    path = tmp_path / "road.xodr"
    path.write_text(BROKEN_END.format(length=500 + last, s=500, x=-47.2, y=0.7, last=last))
    return path


def test_a_broken_last_geometry_moves_nothing_but_is_left_out_and_told(tmp_path, caplog):
    road_map = read_map(_road_with_a_jump(tmp_path, 57.0))
    assert road_map.origin.lat_deg == pytest.approx(48.24, abs=0.05)  # Munich, not the Sahara
    assert np.abs(road_map.extent).max() < 300.0
    assert "jumps by 5391 km at s = 500 m; the last 57 m of the road are left out" in caplog.text


def test_a_jump_before_most_of_the_road_is_refused(tmp_path):
    with pytest.raises(SemlocError, match="road 1: its reference line jumps by 5391 km at s = 500 m, before most"):
        read_map(_road_with_a_jump(tmp_path, 600.0))


@pytest.mark.data
def test_a_real_road_with_a_broken_last_geometry_is_the_one_without_it(data_dir):
    folder = data_dir / "providentia_a9_s40"
    if not folder.is_dir():
        pytest.skip(f"no providentia_a9_s40 in {data_dir}")
    broken, clean = (read_map(folder / f"highway_north{end}.xodr") for end in ("", "_without_last_geometry"))
    assert np.abs(np.subtract(broken.origin, clean.origin)).max() < 1e-3
    assert np.abs(broken.extent - clean.extent).max() < 60.0
