"""Closed town roads: the plan closes, twins look alike, the drive goes round, masks show the map."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import shapely

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.errors import SemlocError
from semloc_jax.maps import SemanticMap, read_map
from semloc_jax.simulation import SimulationConfig, simulate
from semloc_jax.simulation.cameras import front_rig
from semloc_jax.simulation.loop import build_loop, plan_loop
from semloc_jax.simulation.loop_drive import drive_loop, loop_traffic
from semloc_jax.simulation.motion import DrivingStyle
from semloc_jax.simulation.paint import painted_shape
from semloc_jax.simulation.render import PixelRays, render
from semloc_jax.simulation.render_classes import MaskRenderer

SEEDS = range(3)


@pytest.fixture(scope="module", params=SEEDS)
def loop(request):
    """Plan, world and drive of two laps."""
    rng = np.random.default_rng([request.param, 4])
    plan = plan_loop(rng)
    world = build_loop(plan, rng, 0.0)
    tour = drive_loop(plan, world.surface, 2, DrivingStyle(9.0), np.random.default_rng(7))
    return plan, world, tour


def road_of(world):
    return shapely.union_all([shapely.Polygon(a.outline) for a in world.areas if a.class_id == CLASS_IDS["road"]])


def test_the_road_is_closed_and_does_not_cross_itself(loop):
    plan, world, _ = loop
    ring = shapely.LinearRing(plan.line.xy[::10])
    assert ring.is_valid and 600.0 < plan.line.length_m < 1600.0
    assert np.linalg.norm(plan.line.xy[0] - plan.line.xy[-1]) < 0.2
    assert np.abs(plan.line.curvature).max() < 1.0 / 15.0
    holes = road_of(world).interiors if road_of(world).geom_type == "Polygon" else []
    assert max((shapely.Polygon(hole).area for hole in holes), default=0.0) > 5000.0


def test_paint_lies_on_the_road_and_covers_no_other_paint(loop):
    _, world, _ = loop
    road = road_of(world).buffer(0.05)
    painted = [element for element in world.elements if element.is_painted]
    shapes = [painted_shape(element) for element in painted]
    assert all(road.covers(shape) for shape in shapes)
    first, second = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        if a < b and shapes[a].intersection(shapes[b]).area > 0.02:
            raise AssertionError(f"{painted[a].id} lies on {painted[b].id}")
    ids = [element.id for element in world.elements]
    assert len(set(ids)) == len(ids)


def test_posts_stand_beside_the_road(loop):
    _, world, _ = loop
    road = road_of(world)
    feet = [e.points[0, :2] for e in world.elements if e.label.name == "POLE"]
    assert len(feet) > 40
    assert not any(road.contains(shapely.Point(foot)) for foot in feet)


def test_twins_look_alike_and_others_do_not(loop):
    """Every element within 40 m of one twin has a counterpart of the same class at the other, to a centimetre."""
    plan, world, _ = loop
    road = plan.line.unrolled(0.0, plan.line.length_m)

    def around(place):
        (center,), heading = road.at(np.array([place.s_m])), float(road.heading_at(np.array([place.s_m]))[0])
        R = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        seen = [
            (str(e.attributes["class"]), (e.points[:, :2].mean(axis=0) - center) @ R)
            for e in world.elements
            if e.label.name in ("STOP_LINE", "CROSSWALK", "ROAD_MARK", "TRAFFIC_LIGHT")
        ]
        return [(name, at) for name, at in seen if np.linalg.norm(at) < 40.0]

    def unlike(one, other):
        return sum(
            not any(name == known and np.linalg.norm(at - there) < 0.01 for known, there in other) for name, at in one
        )

    twins = [around(place) for place in plan.intersections if place.is_twin]
    assert len(twins) == 2 and len(twins[0]) == len(twins[1]) > 20
    assert unlike(twins[0], twins[1]) == 0
    for place in plan.intersections:
        if not place.is_twin:
            assert unlike(around(place), twins[0]) > 0


def test_there_are_one_and_two_lanes_a_direction(loop):
    plan, _, _ = loop
    width = plan.half_width(np.linspace(0.0, plan.line.length_m, 500))
    assert width.min() == pytest.approx(3.25) and width.max() == pytest.approx(6.5)


def test_the_drive_is_closed_stops_and_changes_lanes(loop):
    _, world, tour = loop
    time_s = np.arange(0.0, tour.end_s, 0.2)
    T = tour.motion.poses(time_s)
    assert np.linalg.norm(T[-1, :3, 3] - T[0, :3, 3]) < 2.5
    assert T[0, :3, 0] @ T[-1, :3, 0] > 0.99
    road = road_of(world)
    assert all(road.contains(shapely.Point(xy)) for xy in T[::10, :2, 3])
    assert len(tour.stops) >= 2
    for at, duration_s in tour.stops:
        stood = tour.motion.poses(np.linspace(at + 0.3, at + duration_s - 0.3, 5))
        assert np.ptp(stood[:, :2, 3], axis=0).max() < 0.05
    speed = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) / 0.2
    assert 5.0 < speed.mean() < 9.0 and speed.max() < 9.5
    # Where there are two lanes the second lap is partly in the other one.
    half = len(T) // 2
    apart = [np.linalg.norm(T[half:, :2, 3] - xy, axis=1).min() for xy in T[:half, :2, 3]]
    assert max(apart) > 2.5 and np.median(apart) < 1.2


@pytest.mark.parametrize("seed", [0, 2])
def test_masks_are_those_of_the_full_renderer(seed):
    """The quick way to class ids gives what casting every ray gives, traffic and all."""
    rng = np.random.default_rng([seed, 4])
    plan = plan_loop(rng)
    world = build_loop(plan, rng, 0.1)
    tour = drive_loop(plan, world.surface, 1, DrivingStyle(9.0), rng)
    scene = replace(world, traffic=loop_traffic(plan, world.surface, tour, rng)).scene()
    rig = front_rig(160, 100)
    rays, T_base_cam = PixelRays(rig.cameras[0]), np.asarray(rig.T_base_cam)[0]
    quick = MaskRenderer(scene, rays, T_base_cam)
    for time_s in np.linspace(0.0, tour.end_s, 4).tolist():
        T_map_cam = tour.motion.pose(time_s) @ T_base_cam
        exact = render(scene, rays, T_map_cam, (), time_s).class_id
        assert (quick.classes(T_map_cam, time_s) != exact).mean() < 2e-4


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    config = SimulationConfig(width_px=240, height_px=150, rate_hz=0.1, laps=1, wear_share=0.0, has_images=False)
    return simulate("loop", 1, tmp_path_factory.mktemp("loop") / "drive", config)


def test_a_drive_of_a_loop_has_the_layout_of_drives(drive):
    told = json.loads((drive.path / "meta.json").read_text())
    assert told["laps"] == 1 and sum(place["twin"] for place in told["intersections"]) == 2
    assert len(told["stops"]) >= 1 and told["sensors"]["gps_dropout"] is not None
    for name in ("changes.json", "element_ids.json", "map_errors_log.json", "gps.csv", "imu.csv", "wheel_odom.csv"):
        assert (drive.path / name).is_file()
    assert json.loads((drive.path / "element_ids.json").read_text())[1:] == [
        element.id for element in read_map(drive.map_path).elements
    ]
    first, last = drive.truth.T_map_base[[0, -1], :3, 3]
    assert len(drive) > 8 and np.linalg.norm(first - last) < 9.0 * 10.0


def test_the_map_is_where_the_masks_show_it(drive):
    """Middles of painted areas in front of the camera are pixels of their class, unless a car is in front of them."""
    camera, T_base_cam = drive.rig.cameras[0], np.asarray(drive.rig.T_base_cam)[0]
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=float)
    d = np.array([float(v) for v in (camera.k1, camera.k2, camera.p1, camera.p2)])
    elements = [e for e in SemanticMap(read_map(drive.map_path).elements).elements if e.is_painted]
    right = wrong = 0
    for frame in drive.frames:
        T_cam_map = np.linalg.inv(drive.truth_at(frame) @ T_base_cam)
        mask = frame.mask("sem", "front")
        for element in elements:
            inside = element.points.mean(axis=0) if element.closed else element.points[len(element.points) // 2]
            p_cam = T_cam_map[:3, :3] @ inside + T_cam_map[:3, 3]
            if not 3.0 < p_cam[2] < 14.0 or abs(p_cam[0]) > 0.5 * p_cam[2] or element.attributes["class"] == "arrow":
                continue
            uv, _ = cv2.projectPoints(p_cam[None], np.zeros(3), np.zeros(3), K, d)
            u, v = np.round(uv[0, 0]).astype(int)
            if 1 <= u < mask.shape[1] - 1 and 1 <= v < mask.shape[0] - 1:
                shown = set(mask[v - 1 : v + 2, u - 1 : u + 2].ravel().tolist())
                if CLASS_IDS["vehicle"] not in shown:
                    hit = CLASS_IDS[str(element.attributes["class"])] in shown
                    right, wrong = right + hit, wrong + (not hit)
    assert right > 20 and wrong <= 0.03 * right


def test_laps_and_frames_that_cannot_be_are_refused(tmp_path):
    small = SimulationConfig(width_px=64, height_px=40, has_images=False)
    with pytest.raises(SemlocError, match="a road has no laps"):
        simulate("road", 1, tmp_path / "a", replace(small, laps=2))
    with pytest.raises(SemlocError, match="leave it out for all of them"):
        simulate("loop", 1, tmp_path / "b", replace(small, laps=1, num_frames=100_000))


@pytest.mark.slow
def test_a_loop_can_be_localized_in(tmp_path):
    """Exact masks in the exact map: every fifth second of a lap within centimetres of the truth."""
    import semloc_jax as sj

    config = SimulationConfig(laps=1, rate_hz=0.15, has_images=False, wear_share=0.0)
    drive = simulate("loop", 3, tmp_path / "loop", config)
    results = sj.localize_frames(drive, sj.read_map(drive.map_path), "sem", "gnss")
    errors_m = [np.linalg.norm((r.T_map_base - drive.truth_at(r.frame))[:2, 3]) for r in results if r.localized]
    assert len(errors_m) >= 0.5 * len(drive)
    assert np.median(errors_m) < 0.05 and max(errors_m) < 0.5
