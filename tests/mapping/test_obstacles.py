"""Obstacles from masks: where boxes stand that OpenCV projected, which places could be seen, size and direction."""

import cv2
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.object_tracks import Tracker
from semloc_jax.mapping.obstacle_sights import Obstacle, ObstacleConfig, ObstacleObserver
from semloc_jax.mapping.obstacle_tracks import ObstacleTrack
from semloc_jax.mapping.road_heights import RoadHeights
from semloc_jax.perception import load_class_table
from semloc_jax.perception.class_table import table_of
from semloc_jax.perception.obstacle_classes import obstacle_ids
from tests.perception.four_fisheyes import NAMES, four_fisheyes, seen_ground
from tests.perception.test_cylinder_view import D, K

IDS = {"cone": 24, "ground_lock": 28, "vehicle": 7}
SIZES = {"cone": (0.4, 0.4, 0.72), "ground_lock": (0.16, 0.56, 0.4), "vehicle": (1.0, 3.0, 1.4)}


@pytest.fixture(scope="module")
def rig():
    return four_fisheyes()


@pytest.fixture(scope="module")
def ground(rig):
    return [np.where(down, 1, 6).astype(np.uint8) for _, down in seen_ground(rig)]


def looking(rig, names=NAMES, kind="cylinder"):
    masks = MaskSource("drawn", load_class_table("drive"), names, lambda frame, name: None)
    return ObstacleObserver(rig, masks, ObstacleConfig(input=kind))


@pytest.fixture(scope="module", params=["cylinder", "fisheye"])
def observer(request, rig):
    return looking(rig, kind=request.param)


def corners(kind, xy, yaw):
    length, width, height = SIZES[kind]
    c, s = np.cos(yaw), np.sin(yaw)
    flat = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [length, width] @ np.array([[c, s], [-s, c]]) + xy
    return np.concatenate([np.column_stack([flat, np.full(4, z)]) for z in (0.0, height)])


def drawn(rig, ground, things, T):
    """Masks of boxes in odom: edges cut into short pieces, projected by OpenCV, the hull of them filled."""
    masks = [mask.copy() for mask in ground]
    share = np.linspace(0.0, 1.0, 12)[:, None]
    for kind, xy, yaw in things:
        box = (corners(kind, np.asarray(xy, float), yaw) - T[:3, 3]) @ T[:3, :3]
        edges = [(k, (k + 1) % 4) for k in range(4)] + [(k, k + 4) for k in range(4)]
        edges += [(a + 4, b + 4) for a, b in edges[:4]]
        places = np.concatenate([box[a] + share * (box[b] - box[a]) for a, b in edges])
        for mask, T_base_cam in zip(masks, np.asarray(rig.T_base_cam), strict=True):
            p_cam = (places - T_base_cam[:3, 3]) @ T_base_cam[:3, :3]
            if (p_cam[:, 2] < 0.1).any():  # beyond what OpenCV can project
                continue
            uv = cv2.fisheye.projectPoints(p_cam[None], np.zeros(3), np.zeros(3), K, D)[0][0]
            cv2.fillConvexPoly(mask, cv2.convexHull(np.round(uv * 16).astype(np.int32)), IDS[kind], shift=4)
    return masks


def pose(x=0.0):
    T = np.eye(4)
    T[0, 3] = x
    return T


def heights():
    Ts = np.stack([pose(x) for x in np.arange(-5.0, 5.0, 0.5)])
    return RoadHeights.of(Ts, 10, 25.0)


def test_a_thing_is_seen_where_it_stands(observer, rig, ground):
    things = [("cone", (5.5, 1.0), 0.0), ("cone", (2.0, 4.0), 0.0), ("ground_lock", (-3.0, -1.5), 0.2)]
    frame = observer.seen(drawn(rig, ground, things, pose()), heights(), pose())
    assert sorted(o.kind for o in frame.obstacles) == ["cone", "cone", "ground_lock"]
    for thing in frame.obstacles:
        off = min((thing.pose[:2] - xy for kind, xy, _ in things if kind == thing.kind), key=lambda o: np.hypot(*o))
        limit = 0.12 if observer.config.input == "cylinder" else 0.3
        assert np.hypot(*off) < limit
        if observer.config.input == "cylinder":
            assert off @ np.linalg.solve(thing.covariance[:2, :2], off) < 9.21


def test_a_foot_that_is_hidden_tells_nothing(rig, ground):
    front, observer = rig.select(["front"]), looking(rig, ("front",))
    cone, car = ("cone", (7.0, 0.0), 0.0), ("vehicle", (5.8, 0.0), 0.0)
    assert len(observer.seen(drawn(front, ground[:1], [cone], pose()), heights(), pose()).obstacles) == 1
    frame = observer.seen(drawn(front, ground[:1], [cone, car], pose()), heights(), pose())
    assert frame.obstacles == []
    # And it is not missed there, but it would be in the open.
    assert not frame.shows("cone", np.array([7.0, 0.0]))
    assert frame.shows("cone", np.array([5.0, 3.0])) and not frame.shows("cone", np.array([30.0, 0.0]))


def test_two_behind_one_another_are_two(rig, ground):
    observer = looking(rig)
    things = [("cone", (5.2, 0.0), 0.0), ("cone", (7.2, 0.75), 0.0)]
    frame = observer.seen(drawn(rig, ground, things, pose()), heights(), pose())
    assert len(frame.obstacles) == 2
    near, far = sorted(frame.obstacles, key=lambda thing: thing.pose[0])
    assert near.pose[0] == pytest.approx(5.2, abs=0.12) and far.pose[0] == pytest.approx(7.2, abs=0.4)
    assert near.is_whole and not far.is_whole


def test_many_frames_tell_place_size_and_direction(rig, ground):
    observer, tracker, lock = looking(rig), Tracker(ObstacleTrack), ("ground_lock", (2.0, 3.0), 1.2)
    for k, x in enumerate(np.linspace(-3.0, 3.0, 13)):
        frame = observer.seen(drawn(rig, ground, [lock], pose(x)), heights(), pose(x))
        visible = np.array([frame.shows(t.kind, t.pose[:2]) for t in tracker.tracks], bool)
        tracker.step(frame.obstacles, 0.2 * k, 0.5 * k, visible)
    (track,) = tracker.final()
    assert np.abs(track.pose[:2] - [2.0, 3.0]).max() < 0.04
    box = track.footprint()
    assert (box.length_m, box.width_m) == pytest.approx((0.16, 0.56), abs=0.04)
    assert abs((box.yaw_rad - 1.2 + np.pi / 2) % np.pi - np.pi / 2) < 0.15
    assert 0.03 <= box.sigma_yaw_rad < 0.2
    assert track.existence > 0.98


def test_from_one_side_no_direction_is_told():
    track = Tracker(ObstacleTrack)
    for k in range(6):
        sight = Obstacle(
            "cone", np.array([5.0, 0.0, 0.0]), np.eye(3) * 0.01, np.zeros(3), 0.1, np.array([0.1 * k, 0.0]), True
        )
        track.step([sight], float(k), 0.1 * k, np.ones(len(track.tracks), bool))
    (one,) = track.final()
    box = one.footprint()
    assert box.sigma_yaw_rad == pytest.approx(np.pi / 2) and box.width_m == pytest.approx(0.475, abs=0.01)


def test_class_tables_name_obstacles():
    assert obstacle_ids(load_class_table("drive")) == {
        "cone": (24,), "pillar": (23,), "ground_lock": (28,), "no_parking_sign": (29,)
    }  # fmt: skip
    assert obstacle_ids(table_of({5: "cone"})) == {"cone": (5,)}
    assert obstacle_ids(table_of({1: "lane_marking"})) == {}


def test_masks_without_obstacles_are_told(rig):
    masks = MaskSource("drawn", table_of({1: "lane_marking"}), NAMES, lambda frame, name: None)
    with pytest.raises(SemlocError, match="knows no obstacles"):
        ObstacleObserver(rig, masks)


def test_one_thing_in_each_place():
    """A pillar that was told twice, 0.2 m apart, is the one seen more; one beside it stays."""
    tracker = Tracker(ObstacleTrack)

    def sight(kind, x):
        return Obstacle(kind, np.array([x, 3.0, 0.0]), np.eye(3) * 1e-4, np.zeros(3), 0.2, np.array([x, 0.0]), True)

    for k in range(6):
        seen = [sight("pillar", 0.0), sight("pillar", 1.5)] + ([sight("cone", 0.2)] if k < 3 else [])
        tracker.step(seen, float(k), 0.1 * k, np.zeros(len(tracker.tracks), bool))
    assert [(t.kind, round(float(t.pose[0]), 2)) for t in tracker.final()] == [("pillar", 0.0), ("pillar", 1.5)]
