"""Obstacles from a network's boxes: places, which sights count, what is missed. The network here knows the truth."""

from pathlib import Path

import numpy as np
import pytest

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.net_obstacles import NetObstacleObserver
from semloc_jax.mapping.object_tracks import Tracker
from semloc_jax.mapping.obstacle_sights import Obstacle
from semloc_jax.mapping.obstacle_tracks import NetObstacleTrack
from semloc_jax.perception.class_table import table_of
from semloc_jax.perception.networks.obstacle_net import KINDS, FoundObstacles, ObstacleNet, net_view
from tests.mapping.test_obstacles import corners, pose
from tests.perception.four_fisheyes import NAMES, four_fisheyes, seen_ground

THINGS = [("cone", (5.5, 1.0), 0.0), ("cone", (2.0, 4.0), 0.3), ("ground_lock", (-3.0, -1.5), 0.2)]


class Black:
    """A picture of a recording."""

    def read(self):
        return np.zeros((480, 640, 3), np.uint8)


class Knowing(ObstacleNet):
    """Says the boxes of things that stand around the car, camera after camera."""

    def __init__(self, rig, things, has_foot=True):
        self.views = [net_view(c, T) for c, T in zip(rig.cameras, np.asarray(rig.T_base_cam, float), strict=True)]
        self.things, self.has_foot, self.turn = things, has_foot, 0

    def __call__(self, picture, threshold=None):
        view, found = self.views[self.turn % len(self.views)], []
        self.turn += 1
        for kind, xy, yaw in self.things:
            places = corners(kind, np.asarray(xy), yaw)
            uv, shown = view.foot(np.concatenate([places, [[*xy, 0.0]]]))
            if shown.all():
                box = [*uv[:8].min(axis=0), *uv[:8].max(axis=0)]
                found.append((KINDS.index(kind), box, uv[8]))
        num = len(found)
        return FoundObstacles(
            np.array([f[0] for f in found], int),
            np.array([f[1] for f in found], float).reshape(-1, 4),
            np.array([f[2] for f in found], float).reshape(-1, 2),
            np.full(num, self.has_foot),
            np.full(num, 0.9),
        )


@pytest.fixture(scope="module")
def rig():
    return four_fisheyes()


@pytest.fixture(scope="module")
def ground(rig):
    return dict(zip(NAMES, [np.where(down, 1, 6).astype(np.uint8) for _, down in seen_ground(rig)], strict=True))


def made(rig, ground, net, has_images=True):
    files = {"rgb": dict.fromkeys(NAMES, Black())} if has_images else {}
    frame = Frame(0, "0", 0.0, "", rig, files)
    drive = Drive("lot", Path("lot"), (frame,), rig, table_name="drive")
    # Masks need not show obstacles: the network does.
    masks = MaskSource("sem", table_of({15: "lane_marking"}), NAMES, lambda _, name: ground[name])
    return NetObstacleObserver(drive, masks, net), frame


@pytest.fixture(scope="module")
def looking(rig, ground):
    return made(rig, ground, Knowing(rig, THINGS))


def test_things_stand_where_their_boxes_say(looking):
    observer, frame = looking
    seen = observer.at(frame, 0, pose()[None])
    assert sorted(thing.kind for thing in seen.obstacles) == ["cone", "cone", "ground_lock"]
    for thing in seen.obstacles:
        off = min((thing.pose[:2] - xy for kind, xy, _ in THINGS if kind == thing.kind), key=lambda o: np.hypot(*o))
        assert np.hypot(*off) < 0.12
        assert off @ np.linalg.solve(thing.covariance[:2, :2], off) < 9.21
        assert thing.is_whole
    assert seen.shows("cone", np.array([5.0, 3.0])) and not seen.shows("cone", np.array([30.0, 0.0]))


def test_without_a_foot_nothing_is_told(looking):
    observer, frame = looking
    observer.net.has_foot = False
    assert observer.at(frame, 0, pose()[None]).obstacles == []


def test_a_camera_without_images_is_told(rig, ground):
    with pytest.raises(SemlocError, match="camera front has no images.*--front masks"):
        made(rig, ground, Knowing(rig, []), has_images=False)


def sighted(xy_camera, xy, sigma_m):
    """A cone as a camera sees it: exact across the line of sight, `sigma_m` along it."""
    along = (np.asarray(xy) - xy_camera) / np.linalg.norm(np.asarray(xy) - xy_camera)
    covariance = np.diag([0.0, 0.0, 9.0])
    covariance[:2, :2] = 0.02**2 * np.eye(2) + sigma_m**2 * np.outer(along, along)
    return Obstacle("cone", np.array([*xy, 0.0]), covariance, np.zeros(3), 0.1, np.asarray(xy_camera), True)


@pytest.mark.parametrize(
    ("cameras", "sigma_m", "confirmed"),
    [
        ([(0.0, 0.0), (0.5, 0.0), (1.0, 0.0)], 0.6, [False] * 3),  # far off, from one side
        ([(0.0, 0.0), (1.5, 0.0), (3.0, 0.0)], 0.6, [False, False, True]),  # far off, lines of sight cross at 30 deg
        ([(0.0, 0.0), (0.5, 0.0), (1.0, 0.0)], 0.1, [False, False, True]),  # a foot that is near
        ([(0.0, 0.0)] * 6 + [(3.0, 0.0)], 0.6, [False] * 6 + [True]),  # it waits until they cross
    ],
)
def test_what_three_frames_show_from_one_side_is_not_confirmed(cameras, sigma_m, confirmed):
    tracker = Tracker(NetObstacleTrack)
    for k, (camera, expected) in enumerate(zip(cameras, confirmed, strict=True)):
        (track,) = tracker.step([sighted(camera, (4.0, 5.0), sigma_m)], 0.2 * k, camera[0], np.ones(min(k, 1), bool))
        assert track.confirmed is expected
    assert len(tracker.final()) == confirmed[-1]
