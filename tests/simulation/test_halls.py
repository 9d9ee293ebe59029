"""Garages with rings of aisles: slots of three types, nothing on anything else, a drive that ends in a slot."""

import json

import cv2
import numpy as np
import pytest
import shapely

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import read_map
from semloc_jax.simulation import SimulationConfig, simulate
from semloc_jax.simulation.epochs import at_epoch
from semloc_jax.simulation.garage import build_garage
from semloc_jax.simulation.motion import DrivingStyle
from semloc_jax.simulation.parking import build_hall, with_cars
from semloc_jax.simulation.parking_drive import choose_target, drive_parking
from semloc_jax.simulation.parking_plan import plan_parking
from semloc_jax.simulation.slot_rows import LETTERS, number_box, number_paint

STYLE = DrivingStyle(2.4, 0.9, 0.8)


@pytest.fixture(scope="module", params=range(4))
def hall(request):
    """Plan, world with cars, drive of two laps."""
    rng = np.random.default_rng([request.param, 5])
    plan = plan_parking(rng, (3, 4), (1, 2))
    world = build_hall(plan, rng, 0.0)
    target = choose_target(plan, 2, rng)
    tour = drive_parking(plan, world.surface, 2, STYLE, target, rng)
    return plan, with_cars(world, plan, {target.row.slot_id(k) for k in target.num_beside}, 0.5, rng), tour


def slots_of(world):
    return [e for e in world.elements if e.label.name == "PARKING_SLOT"]


def test_slots_are_of_three_types_with_their_own_shapes(hall):
    _, world, _ = hall
    slots = slots_of(world)
    assert {e.attributes["kind"] for e in slots} == {"perp", "par", "ang"}
    for slot in slots:
        front, side = (slot.points[b, :2] - slot.points[a, :2] for a, b in ((0, 1), (1, 2)))
        angle_deg = np.degrees(np.arccos(abs(front @ side) / np.linalg.norm(front) / np.linalg.norm(side)))
        width_m, length_m = np.linalg.norm(front), np.linalg.norm(side)
        assert angle_deg == pytest.approx(60.0 if slot.attributes["kind"] == "ang" else 90.0, abs=0.01)
        if slot.attributes["kind"] == "par":
            assert width_m > 5.5 and length_m < 2.6
        else:
            assert 2.3 < width_m * np.sin(np.radians(angle_deg)) < 2.8 and 4.8 < length_m < 5.6


def test_slots_lie_beside_each_other_and_paint_on_no_other_paint(hall):
    _, world, _ = hall
    shapes = [shapely.Polygon(e.points[:, :2]).buffer(-0.01) for e in slots_of(world)]
    first, second = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    assert (first == second).all()
    painted = [e for e in world.elements if e.is_painted]
    shapes = [shapely.Polygon(e.points[:, :2]) for e in painted]
    first, second = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        # Bars of one row, and of two rows back to back, meet at corners.
        assert a >= b or shapes[a].intersection(shapes[b]).area < 0.03, (painted[a].id, painted[b].id)
    ids = [e.id for e in world.elements]
    assert len(set(ids)) == len(ids)


def test_the_way_keeps_clear_of_slots_pillars_and_cones_until_it_parks(hall):
    _, world, tour = hall
    before = np.arange(0.0, tour.reverse_s, 0.25)
    T = tour.motion.poses(before)
    body = np.array([[-0.9, -0.85], [3.75, -0.85], [3.75, 0.85], [-0.9, 0.85]])
    shapes = [shapely.Polygon(body @ pose[:2, :2].T + pose[:2, 3]) for pose in T]
    slots = shapely.union_all([shapely.Polygon(e.points[:, :2]) for e in slots_of(world)])
    standing = [e for e in world.elements if e.label.name in ("PILLAR", "CONE")]
    solid = shapely.union_all([shapely.MultiPoint(e.points[:, :2]).convex_hull.buffer(0.15) for e in standing])
    assert not any(shape.intersects(solid) for shape in shapes)
    assert np.mean([shape.intersection(slots).area > 0.05 for shape in shapes]) < 0.02
    cars = [np.asarray(body.center)[:2] for body in world.parked]
    assert min(np.linalg.norm(T[:, :2, 3] - center, axis=1).min() for center in cars) > 1.9


def test_the_drive_goes_round_and_ends_backed_into_its_slot(hall):
    plan, world, tour = hall
    T = tour.motion.poses(np.linspace(0.0, tour.end_s, 800))
    assert T[:, 0, 3].max() > plan.x_m[-1] and T[:, 1, 3].max() > plan.y_m[-1]
    slot = next(e for e in slots_of(world) if e.id == tour.target.row.slot_id(tour.target.slot))
    assert not slot.attributes["occupied"]
    last = T[-1]
    center = last[:2, 3] + 1.4 * last[:2, 0]
    assert shapely.Polygon(slot.points[:, :2]).buffer(-0.6).contains(shapely.Point(center))
    inward = slot.points[3, :2] - slot.points[0, :2]
    assert last[:2, 0] @ inward / np.linalg.norm(inward) < -0.999
    stood = tour.motion.poses(np.linspace(tour.end_s - 1.5, tour.end_s, 5))
    assert np.ptp(stood[:, :3, 3], axis=0).max() < 0.01
    step = np.diff(T[:, :2, 3], axis=0)
    along = (step * T[:-1, :2, 0]).sum(axis=1)
    since_s = np.linspace(0.0, tour.end_s, 800)[:-1] - tour.reverse_s
    # The time table knows the place where the direction changes to half of its step of 0.1 m.
    assert (along[since_s < -1.0] > -0.05).all() and (along[since_s > 1.0] < 1e-3).all()
    assert along[since_s < -1.0].sum() > 200.0 and along[since_s > 1.0].sum() < -7.0
    heading = np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
    assert np.abs(np.diff(heading)).max() < 0.25


def test_numbers_are_inside_their_slots_and_differ(hall):
    plan, _, _ = hall
    row = next(row for row in plan.rows if row.kind == "perp")
    inked = [number_paint(row, slot) for slot in range(row.count)]
    for slot, ink in enumerate(inked):
        assert shapely.Polygon(row.outline(slot)).contains(ink)
        assert shapely.Polygon(number_box(row, slot)).buffer(1e-6).covers(ink) and ink.area > 0.05
    assert inked[0].area != pytest.approx(inked[2].area)
    assert len(set(LETTERS)) == len(LETTERS)


def test_halls_differ_from_seed_to_seed():
    plans = [plan_parking(np.random.default_rng([seed, 5]), (3, 4), (1, 2)) for seed in range(8)]
    assert len({len(plan.x_m) for plan in plans}) == 2 and len({len(plan.y_m) for plan in plans}) == 2
    assert len({sum(row.count for row in plan.rows) for plan in plans}) > 5


@pytest.mark.parametrize("epoch", [1, 2])
def test_an_epoch_of_a_garage_is_the_same_on_every_drive(epoch):
    worlds = [
        build_garage(np.random.default_rng([3, 0]), 30.0, 0.0, own)
        for own in (None, np.random.default_rng(8), np.random.default_rng(9))
    ]
    changes = [at_epoch(world, [3, 0], epoch)[1] for world in worlds]
    assert changes[0] == changes[1] == changes[2] and changes[0]["since_epoch_0"]


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    config = SimulationConfig(width_px=240, height_px=180, rate_hz=0.05, laps=1, wear_share=0.0, has_images=False)
    return simulate("garage", 2, tmp_path_factory.mktemp("hall") / "drive", config)


def test_a_drive_of_a_hall_has_the_layout_of_drives(drive):
    told = json.loads((drive.path / "meta.json").read_text())
    assert told["kind"] == "garage" and told["laps"] == 1 and told["sensors"]["gps_bias"] is None
    assert drive.gnss is None and not (drive.path / "gps.csv").exists()
    fix, first = told["entrance_fix"], drive.truth.T_map_base[0]
    assert np.hypot(fix["east_m"] - first[0, 3], fix["north_m"] - first[1, 3]) < 4.0 * fix["sigma_m"]
    elements = {e.id: e for e in read_map(drive.map_path).elements}
    assert told["target_slot"] in elements and len(told["surveyed"]) == 6
    for pair in told["surveyed"]:
        a, b = (np.array(pair[end]["point"]) for end in "ab")
        assert np.linalg.norm(a - b) == pytest.approx(pair["distance_m"], abs=1e-3)
        assert min(np.linalg.norm(elements[pair["a"]["id"]].points - a, axis=1)) < 1e-3
        assert min(np.linalg.norm(elements[pair["b"]["id"]].points - b, axis=1)) < 1e-3
    features = json.loads((drive.path / "map.geojson").read_text())["features"]
    assert sum(feature["properties"]["class"] == "slot_number" for feature in features) > 20


def test_the_tip_of_an_arrow_is_its_farthest_point(drive):
    told = json.loads((drive.path / "meta.json").read_text())["surveyed"]
    elements = {e.id: e for e in read_map(drive.map_path).elements}
    tips = [pair["b"] for pair in told if pair["b"]["what"].startswith("tip")]
    for tip in tips:
        points = elements[tip["id"]].points
        tail = points[0]
        assert np.argmax(np.linalg.norm(points - tail, axis=1)) == np.argmin(
            np.linalg.norm(points - tip["point"], axis=1)
        )
    assert tips


def test_the_map_is_where_the_masks_show_it(drive):
    """Middles of bars and arrows near the vehicle are pixels of their class, unless a car or a pillar is in front."""
    hidden = {CLASS_IDS[name] for name in ("vehicle", "pillar", "cone", "ego", "unlabeled", "sign")}
    elements = [e for e in read_map(drive.map_path).elements if e.label.name == "SLOT_LINE"]
    middles = np.array([e.points[:, :3].mean(axis=0) for e in elements])
    right = wrong = 0
    for frame in drive.frames:
        for name, camera, T_base_cam in zip(
            drive.rig.names, drive.rig.cameras, np.asarray(drive.rig.T_base_cam), strict=True
        ):
            T_cam_map = np.linalg.inv(drive.truth_at(frame) @ T_base_cam)
            p_cam = middles @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]
            near = (p_cam[:, 2] > 0.5) & (np.linalg.norm(p_cam, axis=1) < 5.0)
            K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=float)
            d = np.array([float(v) for v in (camera.k1, camera.k2, camera.k3, camera.k4)])
            if not near.any():
                continue
            uv, _ = cv2.fisheye.projectPoints(p_cam[near][:, None], np.zeros(3), np.zeros(3), K, d)
            mask = frame.mask("sem", name)
            for u, v in np.round(uv[:, 0]).astype(int):
                if 1 <= u < mask.shape[1] - 1 and 1 <= v < mask.shape[0] - 1:
                    shown = set(mask[v - 1 : v + 2, u - 1 : u + 2].ravel().tolist())
                    if not shown & hidden:
                        hit = CLASS_IDS["slot_line"] in shown
                        right, wrong = right + hit, wrong + (not hit)
    assert right > 10 and wrong <= 0.05 * right


@pytest.mark.slow
def test_a_hall_can_be_localized_in(tmp_path):
    """Exact masks of four fisheyes in the exact map, from the true place a little off: within centimetres."""
    import semloc_jax as sj

    config = SimulationConfig(laps=1, rate_hz=0.1, has_images=False, wear_share=0.0)
    drive = simulate("garage", 4, tmp_path / "hall", config)
    results = sj.localize_frames(drive, sj.read_map(drive.map_path), "sem", "truth")
    errors_m = [np.linalg.norm((r.T_map_base - drive.truth_at(r.frame))[:2, 3]) for r in results if r.localized]
    assert len(errors_m) >= 0.6 * len(drive)
    assert np.median(errors_m) < 0.03 and max(errors_m) < 0.3
