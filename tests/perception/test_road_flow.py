"""Corners of a road that goes by: which of them tell how fast, and where they will be seen next."""

import cv2
import numpy as np
import pytest

from semloc_jax.cameras import KannalaBrandtCamera, PinholeCamera, Rig
from semloc_jax.geometry import rigid
from semloc_jax.perception.corners import new_corners
from semloc_jax.perception.road_flow import moved_over_road, road_ahead, road_as_seen_now
from semloc_jax.perception.sight_lines import sight_grid, sight_lines
from semloc_jax.perception.tracks import CornerConfig, FeatureTracker, Scenery
from tests.perception.test_patches import road_from

FOCAL_PX, CENTRE, LIFT_M = 300.0, np.array([159.5, 119.5]), 1.4
T_BASE_CAM = np.eye(4)
T_BASE_CAM[:3, :3] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
T_BASE_CAM[2, 3] = LIFT_M
PINHOLE = PinholeCamera(FOCAL_PX, FOCAL_PX, *CENTRE, 320.0, 240.0)
FISHEYE = KannalaBrandtCamera(110.0, 110.0, *CENTRE, 320.0, 240.0, -0.013, -0.0042, 0.0011, -0.0002)
RIG = Rig([PINHOLE], T_BASE_CAM[None], ["front"])
ROAD = np.arange(240)[:, None] > np.full(320, 130.0)


def on_road_ahead(num, seed):
    """Points of the road, in the camera [m]."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-3, 3, num), np.full(num, LIFT_M), rng.uniform(3.5, 12, num)])


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE])
def test_corners_of_the_road_are_foretold_and_so_is_how_they_are_stretched(camera):
    points, R, moved_m = (
        on_road_ahead(40, 0),
        rigid.exp(np.array([0, 0, 0, 0.002, 0.03, -0.004]))[:3, :3],
        [0.05, 0, 1.1],
    )
    seen = [np.asarray(camera.project(p)[0]) for p in (points, points @ R.T - moved_m)]
    ahead = road_ahead(camera, seen[0], sight_lines(camera, seen[0]), T_BASE_CAM, R, np.array(moved_m))
    assert ahead.in_view.all()
    np.testing.assert_allclose(ahead.uv, seen[1], atol=1e-6)
    # Half a centimetre beside each point, on the road.
    beside = points + np.random.default_rng(1).uniform(-0.005, 0.005, (40, 3)) * [1, 0, 1]
    moves = [
        np.asarray(camera.project(p)[0]) - uv for p, uv in zip((beside, beside @ R.T - moved_m), seen, strict=True)
    ]
    np.testing.assert_allclose(np.einsum("nij,nj->ni", ahead.affine, moves[0]), moves[1], atol=0.02)


def test_what_does_not_lie_on_the_road_ahead_is_left_where_it_is():
    uv = np.array([[160.0, 60.0], [160.0, 121.0], [160.0, 239.0]])  # the sky, far away, under the camera afterwards
    sight = sight_lines(PINHOLE, uv)
    ahead = road_ahead(PINHOLE, uv, sight, T_BASE_CAM, np.eye(3), np.array([0.0, 0.0, 3.5]))
    assert ahead.known.tolist() == [False, False, True] and not ahead.in_view.any()
    np.testing.assert_array_equal(ahead.uv, uv)
    np.testing.assert_array_equal(ahead.affine, np.broadcast_to(np.eye(2), (3, 2, 2)))
    # A camera at the origin of its base, as one given against an inertial sensor, does not know where the road is.
    low = T_BASE_CAM.copy()
    low[2, 3] = 0.0
    uv = np.tile([160.0, 200.0], (12, 1))
    assert not road_ahead(PINHOLE, uv, sight_lines(PINHOLE, uv), low, np.eye(3), np.array([0, 0, 1.0])).known.any()
    same = sight_lines(PINHOLE, uv)
    assert moved_over_road(same.ray_cam, same, low, np.eye(3), np.array([0.0, 0.0, 1.0])) is None


def test_corners_say_how_far_the_camera_went_though_a_third_of_them_stays():
    points, rng = on_road_ahead(60, 2), np.random.default_rng(3)
    R, direction = rigid.exp(np.array([0, 0, 0, 0.003, 0.01, 0.0]))[:3, :3], np.array([0.02, 0.0, 1.0])
    direction /= np.linalg.norm(direction)
    seen = [np.array(PINHOLE.project(p)[0]) for p in (points, points @ R.T - 0.9 * direction)]
    seen[1][:20] = np.asarray(PINHOLE.project(points[:20] @ R.T)[0])
    before, now = (sight_lines(PINHOLE, uv + 0.3 * rng.normal(size=uv.shape)) for uv in seen)
    for sign in (1.0, -1.0):
        moved_m = moved_over_road(before.ray_cam, now, T_BASE_CAM, R, sign * direction)
        np.testing.assert_allclose(moved_m, 0.9 * direction, atol=0.02)
    few = sight_lines(PINHOLE, seen[1][-7:])
    assert moved_over_road(before.ray_cam[-7:], few, T_BASE_CAM, R, direction) is None
    scattered = sight_lines(PINHOLE, rng.uniform([0, 140], [320, 240], (60, 2)))
    assert moved_over_road(before.ray_cam, scattered, T_BASE_CAM, R, direction) is None


def test_the_image_before_is_shown_as_the_road_would_be_seen_now():
    moved_m = np.array([0.0, 0.0, 0.8])
    shown = road_as_seen_now(road_from(0.0), sight_grid(PINHOLE, 10), T_BASE_CAM, np.eye(3), moved_m)
    now, part = road_from(0.8), (slice(150, 195), slice(60, 260))
    assert np.corrcoef(shown[part].ravel(), now[part].ravel())[0, 1] > 0.97
    assert np.corrcoef(road_from(0.0)[part].ravel(), now[part].ravel())[0, 1] < 0.5


def test_near_corners_of_the_road_are_found_again_where_they_are():
    """1.2 m an image: the road 5 m ahead moves by 27 px and grows by a third. Foretold by a speed that is a twentieth
    off it is found again, and says what is true."""
    way_m, found = 1.2, {}
    for name, told in (("not told", None), ("5 % off", np.array([0.95 * way_m, 0.0, 0.0]))):
        tracker, scenery = FeatureTracker(1, CornerConfig()), [Scenery(np.ones((240, 320), bool), ROAD)]
        first = tracker.step([road_from(0.0)], RIG, np.eye(3), scenery)
        second = tracker.step([road_from(way_m)], RIG, np.eye(3), scenery, told)
        same = np.flatnonzero((first.id >= 0) & (first.id == second.id) & (first.uv[:, 1] > 165))
        depth_m = LIFT_M * FOCAL_PX / (first.uv[same, 1] - CENTRE[1])
        true = (first.uv[same] - CENTRE) * (depth_m / (depth_m - way_m))[:, None] + CENTRE
        found[name] = second.uv[same] - true
    off = found["5 % off"]
    assert len(off) >= 25 and len(off) > 1.8 * len(found["not told"])
    # Of 0.5 to 3 px that were foretold too little, nothing is left.
    assert np.median(np.linalg.norm(off, axis=1)) < 0.1 and abs(np.median(off[:, 1])) < 0.03


def test_a_motion_that_was_seen_is_taken_to_go_on():
    way_m, scenery = 1.2, [Scenery(np.ones((240, 320), bool), ROAD)]
    tracker, plain = FeatureTracker(1, CornerConfig()), FeatureTracker(1, CornerConfig())
    num = [tracker.step([road_from(way_m * k)], RIG, np.eye(3), scenery).num_followed for k in range(4)]
    others = [plain.step([road_from(way_m * k)], RIG, np.eye(3)).num_followed for k in range(4)]
    assert num[1] == others[1] and num[3] > 1.5 * others[3]


def stripe(image, left_px, right_px):
    """A marking that leads ahead, between two columns of the lowest row, up to 12 m away."""
    paint = np.zeros(image.shape, np.uint8)
    ends = [np.array([u, 239.0]) for u in (left_px, right_px)]
    far = [CENTRE + (end - CENTRE) * (LIFT_M * FOCAL_PX / 12.0) / (239.0 - CENTRE[1]) for end in ends]
    cv2.fillPoly(
        paint, [np.round(16 * np.array([ends[0], ends[1], far[1], far[0]])).astype(np.int32)], 255, cv2.LINE_8, 4
    )
    return np.where(paint > 0, 220, image).astype(np.uint8), paint > 0


def test_an_edge_that_leads_the_way_is_no_corner():
    """Its stairs are corners as any others, and stay where they are while the road goes by."""
    rng = np.random.default_rng(5)
    plain = np.clip(90 + cv2.GaussianBlur(rng.normal(size=(240, 320)) * 12.0, (0, 0), 1.2), 0, 255).astype(np.uint8)
    image, paint = stripe(plain, 250, 275)
    along = cv2.dilate(paint.astype(np.uint8), np.ones((7, 7))).astype(bool)
    along[:175] = False  # the end of the stripe is a corner
    field = np.stack(np.meshgrid(np.arange(32) * 10 + 4.5, np.arange(24) * 10 + 4.5), axis=-1) - CENTRE
    rules = (None, np.zeros((0, 2)), 400, 12, 8)

    def num_along(corners):
        column, row = np.round(corners).astype(int).T
        return int(along[row, column].sum())

    free, told, turned = (new_corners(image, *rules, flow) for flow in (None, field, -field[..., ::-1] * [1, -1]))
    assert num_along(free) >= 8 and num_along(told) == 0
    assert num_along(turned) >= 6, "across the way an edge says all"
    assert len(told) > 0.6 * len(free)


def test_a_road_that_leaves_the_view_is_not_searched_for():
    """4.5 m an image, and nothing of the road but the part that is under the camera then."""
    near = ROAD & (np.arange(240)[:, None] > 212)
    tracker, scenery = FeatureTracker(1, CornerConfig()), [Scenery(near, near)]
    first = tracker.step([road_from(0.0)], RIG, np.eye(3), scenery)
    second = tracker.step([road_from(0.0)], RIG, np.eye(3), scenery, np.array([4.4, 0.0, 0.0]))
    assert (first.id >= 0).sum() > 10 and not np.isin(second.id, first.id[first.id >= 0]).any()
