"""Drives rendered on maps: borders in the masks against OpenCV's projection, ground against the map, bad input.

The maps are real ones; a drive has three small frames.
"""

from functools import cache

import cv2
import numpy as np
import pytest
import shapely

from semloc_jax.cli.main import FAILED, USAGE, main
from semloc_jax.errors import SemlocError
from semloc_jax.maps import MapElement, SemanticMap, read_lane_centers, read_map, write_drive_geojson
from semloc_jax.simulation import RouteWish, SimulationConfig, simulate_on_map
from semloc_jax.simulation.height_field import surface_through
from semloc_jax.simulation.map_scene import build_map_world
from semloc_jax.simulation.route import drivable, find_route
from semloc_jax.simulation.surface import WaveSurface
from semloc_jax.structs import ElementClass

MAPS = {
    "karlsruhe": "maps_lanelet2_karlsruhe/lanelet2_maps/res/mapping_example.osm",
    "argoverse2": "av2_7fab2350",
    "fabriksgatan": "maps_opendrive_esmini/resources/xodr/fabriksgatan.xodr",
    "e6mini": "maps_opendrive_esmini/resources/xodr/e6mini.xodr",
    "parking_demo": "maps_opendrive_esmini/resources/xodr/parking_demo.xodr",
}
SMALL = SimulationConfig(rate_hz=1.0, width_px=480, height_px=300, wear_share=0.0, has_images=False)
SEEN = ["--rate-hz", "1", "--width-px", "480", "--height-px", "300", "--has-images", "False"]
PAINT = {ElementClass.LANE_MARKING, ElementClass.CROSSWALK, ElementClass.STOP_LINE, ElementClass.SLOT_LINE}


@pytest.fixture
def map_path(request, data_dir):
    path = data_dir / MAPS[request.param]
    if not path.exists():
        pytest.skip(f"no map {path}")
    return path


@cache
def map_at(path):
    return read_map(path)


def inside_paint(drive, frame, radius_m):
    """Share of points in the middle of paint that the mask shows as paint: elements of the map, OpenCV's camera."""
    camera = drive.rig.cameras[0]
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=float)
    d = np.array([float(v) for v in (camera.k1, camera.k2, camera.p1, camera.p2)])
    T = np.linalg.inv(drive.truth_at(frame) @ np.asarray(drive.rig.T_base_cam[0]))
    ids = np.array([drive.class_ids[name] for name in ("lane_solid", "lane_dashed", "crosswalk", "slot_line")])
    ids = np.append(ids, [drive.class_ids["stop_line"], drive.class_ids["vehicle"]])
    mask = frame.mask("sem", "front")
    found = []
    for element in map_at(drive.map_path).elements:
        if element.label not in PAINT or element.is_logical or element.closed or element.width_m < 0.1:
            continue
        line = shapely.LineString(element.points)
        at = np.arange(0.3, line.length - 0.3, 0.5)
        points = np.array([line.interpolate(s).coords[0] for s in at]).reshape(-1, 3)
        p_cam = points @ T[:3, :3].T + T[:3, 3]
        p_cam = p_cam[(p_cam[:, 2] > 4.0) & (p_cam[:, 2] < radius_m) & (np.abs(p_cam[:, 0]) < 0.5 * p_cam[:, 2])]
        if len(p_cam):
            uv = np.round(cv2.projectPoints(p_cam, np.zeros(3), np.zeros(3), K, d)[0][:, 0]).astype(int)
            uv = uv[((uv >= 0) & (uv < camera.resolution)).all(axis=1)]
            found.append(np.isin(mask[uv[:, 1], uv[:, 0]], ids))
    return np.concatenate(found) if found else np.zeros(0, dtype=bool)


@pytest.mark.data
@pytest.mark.parametrize("map_path", MAPS, indirect=True)
def test_the_masks_show_the_paint_where_the_map_has_it(map_path, tmp_path):
    drive = simulate_on_map(map_path, 1, tmp_path / "drive", RouteWish(length_m=30.0), SMALL)
    shown = np.concatenate([inside_paint(drive, frame, 12.0) for frame in drive.frames])
    assert len(shown) > 5
    assert shown.mean() > 0.97
    # Frames stand on the way that was asked for, and fixes and poses are in the frame of the map.
    place = drive.truth.T_map_base[:, :3, 3]
    extent = map_at(map_path).extent
    assert (place[:, :2] > extent[0, :2] - 20.0).all() and (place[:, :2] < extent[1, :2] + 20.0).all()
    assert np.linalg.norm(place[-1] - place[0]) > 8.0
    near = np.abs(drive.gnss.time_s) < 3.0
    assert np.median(np.linalg.norm(drive.gnss.p_enu[near, :2] - place[0, :2], axis=1)) < 60.0


@pytest.mark.data
@pytest.mark.parametrize("map_path", ["karlsruhe", "argoverse2", "e6mini"], indirect=True)
def test_lanes_run_between_their_borders(map_path):
    """Between 1 and 6 m to the left and to the right of the middle of a lane there is a line of the map."""
    found = map_at(map_path)
    lines = shapely.STRtree([shapely.LineString(e.points[:, :2]) for e in found.elements if len(e.points) > 1])
    share = []
    for center in read_lane_centers(map_path, found.origin)[:60]:
        k = len(center) // 2
        step = center[k] - center[k - 1]
        left = np.array([-step[1], step[0]]) / np.hypot(*step[:2])
        for side in (1.0, -1.0):
            ends = [center[k, :2] + side * reach * left for reach in (0.9, 6.0)]
            # As wide as the gap between two bars.
            beside = shapely.LineString(ends).buffer(7.0, cap_style="flat")
            share.append(len(lines.query(beside, predicate="intersects")) > 0)
    assert np.mean(share) > 0.75


def test_the_ground_follows_a_banked_and_rolling_road():
    """Heights of an analytic road, known along lines 1 m apart in s and 3 m in d, come back within a centimetre."""
    truth = WaveSurface(np.array([0.03, -0.02]), np.array([0.4]), np.array([[0.07, 0.0]]), np.zeros(1))
    x, y = np.meshgrid(np.arange(-60.0, 60.0, 1.0), np.arange(-9.0, 9.1, 3.0))
    points = truth.drape(np.column_stack([x.ravel(), y.ravel()]))
    ground = surface_through(points, np.array([-100.0, -60.0]), np.array([100.0, 60.0]))
    rng = np.random.default_rng(0)
    place = rng.uniform([-55.0, -8.0], [55.0, 8.0], (500, 2))
    assert np.abs(ground.height(*place.T) - truth.height(*place.T)).max() < 0.01
    normal = ground.normal(place)
    assert np.degrees(np.arccos(np.sum(normal * truth.normal(place), axis=1))).max() < 0.3


def test_rays_end_at_their_first_hit():
    """Against heights every 2 cm along each ray, over crests that hide valleys."""
    ground = WaveSurface(np.array([0.0, 0.01]), np.array([0.5]), np.array([[0.15, 0.02]]), np.zeros(1))
    rng = np.random.default_rng(1)
    ray = np.column_stack([np.ones(300), rng.uniform(-0.5, 0.5, 300), rng.uniform(-0.3, 0.0, 300)])
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    origin = np.array([0.0, 0.0, 1.5])
    t = np.arange(0.0, 150.0, 0.02)
    path = origin + t[:, None, None] * ray
    below = path[..., 2] < ground.height(path[..., 0], path[..., 1])
    first = np.where(below.any(axis=0), t[np.argmax(below, axis=0)], np.inf)
    hit = ground.hit(origin, ray, 150.0)
    both = np.isfinite(first) & np.isfinite(hit)
    assert both.sum() > 200
    assert np.mean(np.isfinite(first) == np.isfinite(hit)) > 0.99
    assert np.mean(np.abs(hit[both] - first[both]) < 0.03) > 0.99


def test_posts_begin_where_the_ground_ends():
    """Guide posts of e6mini.xodr stand 20 cm deep: the exact map holds what the masks show."""
    along = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0]])
    line = MapElement("line", ElementClass.LANE_MARKING, along, width_m=0.15, style="solid")
    foot = {"deep": -0.2, "high": 0.1}
    posts = [
        MapElement(name, ElementClass.POLE, np.array([[20.0, 5.0, z], [20.0, 5.0, 1.05]])) for name, z in foot.items()
    ]
    path = drivable(np.array([[0.0, -1.75], [40.0, -1.75]]), 40.0)
    semantic_map = SemanticMap((line, *posts), None, "posts")
    world = build_map_world(semantic_map, [], path, 30.0, 5.0, 0.0, np.random.default_rng(0))
    built = {element.id: element for element in world.scene.elements}
    np.testing.assert_allclose(built["deep"].points[:, 2], [0.0, 1.05], atol=1e-9)
    np.testing.assert_allclose(built["high"].points[:, 2], [0.1, 1.05], atol=1e-9)
    assert all(built[name].radius_m == built[name].attributes["radius"] > 0.0 for name in foot)


def test_what_cannot_be_driven_is_said_in_one_line(tmp_path, capsys):
    """A map without lanes is driven along its markings; starts off it, lengths of zero and paths of nothing are not."""
    for length_m in (0.0, -3.0, float("nan")):
        with pytest.raises(SemlocError, match="expected metres to drive"):
            RouteWish(length_m=length_m)
    with pytest.raises(SemlocError, match="no such file"):
        find_route([], [], RouteWish(path=tmp_path / "nowhere.csv"), np.random.default_rng(0))
    along = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0]])
    line = MapElement("line", ElementClass.LANE_MARKING, along, width_m=0.15, style="solid")
    write_drive_geojson(SemanticMap((line,), None, "line"), tmp_path / "line.geojson")
    given = ["simulate", str(tmp_path / "drive"), "--map", str(tmp_path / "line.geojson"), *SEEN]
    for words, code, message in (
        (["--start", "9000,0"], FAILED, "off the nearest lane"),
        (["--start", "here"], USAGE, "expected X,Y"),
    ):
        assert main([*given, *words]) == code
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1
        assert not (tmp_path / "drive").exists()
    assert main(["simulate", str(tmp_path / "x"), "--start", "0,0"]) == USAGE
    assert "give --map" in capsys.readouterr().err
    assert main([*given, "--length-m", "12"]) == 0
    assert "cameras front" in capsys.readouterr().out


def test_a_map_without_anything_painted_is_refused(tmp_path):
    path = tmp_path / "empty.osm"
    path.write_text('<osm version="0.6"><node id="1" lat="49" lon="8"/></osm>')
    with pytest.raises(SemlocError, match="no element that a camera could see"):
        simulate_on_map(path, 0, tmp_path / "drive")
