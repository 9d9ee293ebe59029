"""Open parking lots: rows of slots, and obstacles that keep some of them free."""

import json

import cv2
import numpy as np
import pytest
import shapely

from semloc_jax.cli.main import OK, main
from semloc_jax.datasets import read_drive
from semloc_jax.errors import SemlocError
from semloc_jax.maps import read_map
from semloc_jax.simulation import SimulationConfig, simulate
from semloc_jax.simulation.obstacles import OBSTACLE_IDS, with_obstacles
from semloc_jax.simulation.parking import with_cars
from semloc_jax.simulation.parking_lot import build_lot
from semloc_jax.simulation.parking_plan import plan_parking


@pytest.fixture(scope="module", params=range(2))
def lot(request):
    """Plan, world with cars and obstacles, slots that they keep free."""
    rng = np.random.default_rng([request.param, 6])
    plan = plan_parking(rng, (2, 3), (1, 2))
    world, counts, kept = with_obstacles(build_lot(plan, rng, 0.0), rng)
    return plan, with_cars(world, plan, kept, 0.5, rng), counts, kept


def test_obstacles_stand_in_their_slots_and_no_car_does(lot):
    _, world, counts, kept = lot
    slots = {e.id: e for e in world.elements if e.label.name == "PARKING_SLOT"}
    assert counts["ground_lock"] > 2 and counts["no_parking_sign"] > 0 and kept
    assert len(world.features) == counts["ground_lock"] + counts["no_parking_sign"]
    for feature in world.features:
        told = feature["properties"]
        outline = shapely.Polygon(slots[told["slot"]].points[:, :2])
        assert outline.contains(shapely.Point(feature["geometry"]["coordinates"][:2]))
        assert told["size"][2] > 0.0
    assert not any(slots[name].attributes["occupied"] for name in kept)
    taken = [e.attributes["occupied"] for e in slots.values()]
    assert 0.2 < np.mean(taken) < 0.6


def test_lamps_and_trees_stand_in_no_slot(lot):
    _, world, _, _ = lot
    slots = shapely.union_all(
        [shapely.Polygon(e.points[:, :2]) for e in world.elements if e.label.name == "PARKING_SLOT"]
    )
    feet = [e.points[0, :2] for e in world.elements if e.label.name == "POLE"]
    assert len(feet) > 5 and not any(slots.intersects(shapely.Point(foot).buffer(0.2)) for foot in feet)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    out = tmp_path_factory.mktemp("lot") / "drive"
    words = ["simulate", str(out), "--kind", "lot", "--seed", "3", "--obstacles", "--masks-only", "--rate-hz", "0.1"]
    assert main([*words, "--width-px", "320", "--height-px", "240", "--wear-share", "0"]) == OK
    return read_drive(out)


def test_a_drive_on_a_lot_tells_of_its_obstacles(drive):
    told = json.loads((drive.path / "meta.json").read_text())
    assert told["kind"] == "lot" and told["obstacles"]["ground_lock"] > 0
    assert all(told["classes"][name] == number for name, number in OBSTACLE_IDS.items())
    assert drive.gnss is not None
    features = json.loads((drive.path / "map.geojson").read_text())["features"]
    kinds = [feature["properties"]["class"] for feature in features]
    assert kinds.count("ground_lock") == told["obstacles"]["ground_lock"]
    assert told["target_slot"] in {e.id for e in read_map(drive.map_path).elements}


def test_masks_show_obstacles_where_the_map_has_them(drive):
    """Middles of obstacles near a camera are pixels of their class, unless something stands before them."""
    features = json.loads((drive.path / "map.geojson").read_text())["features"]
    features = [feature for feature in features if feature["properties"]["class"] in OBSTACLE_IDS]
    shown = seen = 0
    for frame in drive.frames:
        for name, camera, T_base_cam in zip(
            drive.rig.names, drive.rig.cameras, np.asarray(drive.rig.T_base_cam), strict=True
        ):
            T_cam_map, mask = np.linalg.inv(drive.truth_at(frame) @ T_base_cam), frame.mask("sem", name)
            K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=float)
            d = np.array([float(v) for v in (camera.k1, camera.k2, camera.k3, camera.k4)])
            for feature in features:
                foot = np.array(feature["geometry"]["coordinates"])
                height_m = feature["properties"]["size"][2]
                p_cam = T_cam_map[:3, :3] @ (foot + [0.0, 0.0, 0.5 * height_m]) + T_cam_map[:3, 3]
                if p_cam[2] < 0.5 or np.linalg.norm(p_cam) > 7.0 or height_m < 0.2:
                    continue
                (uv,), _ = cv2.fisheye.projectPoints(p_cam[None, None], np.zeros(3), np.zeros(3), K, d)
                u, v = np.round(uv[0]).astype(int)
                if 6 <= u < mask.shape[1] - 6 and 6 <= v < mask.shape[0] - 6:
                    around = mask[v - 6 : v + 7, u - 6 : u + 7]
                    seen += 1
                    shown += OBSTACLE_IDS[feature["properties"]["class"]] in around or 7 in around
    assert seen >= 3 and shown >= 0.85 * seen


def test_obstacles_need_slots(tmp_path):
    with pytest.raises(SemlocError, match="a road has no slots"):
        simulate("road", 1, tmp_path, SimulationConfig(num_frames=1, has_obstacles=True))
