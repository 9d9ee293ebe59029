"""Corners followed through images whose motion is known."""

import cv2
import numpy as np
import pytest

from semloc_jax.cameras import KannalaBrandtCamera, PinholeCamera, Rig
from semloc_jax.geometry import rigid
from semloc_jax.perception.corners import new_corners
from semloc_jax.perception.epipolar_gate import moves_with_the_world
from semloc_jax.perception.sight_lines import sight_lines
from semloc_jax.perception.tracks import CornerConfig, FeatureTracker, Scenery, px_per_rad

K = np.array([[300.0, 0.0, 159.5], [0.0, 300.0, 119.5], [0.0, 0.0, 1.0]])
RIG = Rig([PinholeCamera(300.0, 300.0, 159.5, 119.5, 320.0, 240.0)], np.eye(4)[None], ["front"])
CONFIG = CornerConfig(num_tracks=60, bucket_px=32)


def texture(seed=0, size=(240, 320)):
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.uniform(0, 255, size=size).astype(np.float32), (0, 0), 2.0)
    return np.clip((noise - noise.mean()) * 6.0 + 128.0, 0, 255).astype(np.uint8)


def turned(image, R_now_before):
    """The image after a rotation of the camera."""
    H = K @ R_now_before @ np.linalg.inv(K)
    return cv2.warpPerspective(image, H, image.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def test_corners_follow_a_turning_camera_to_a_twentieth_of_a_pixel():
    image = texture()
    R = rigid.exp(np.array([0, 0, 0, 0.004, -0.012, 0.01]))[:3, :3]
    tracker = FeatureTracker(1, CONFIG)
    first = tracker.step([image], RIG, np.eye(3))
    second = tracker.step([turned(image, R)], RIG, R)
    same = (first.id >= 0) & (first.id == second.id)
    assert same.sum() >= 35 and second.num_followed == same.sum()
    expected = first.sight.ray_cam[same] @ R.T
    expected = expected[:, :2] / expected[:, 2:] * 300.0 + [159.5, 119.5]
    off_px = np.linalg.norm(second.uv[same] - expected, axis=1)
    assert np.median(off_px) < 0.05 and np.percentile(off_px, 90) < 0.15
    # The rotation that best explains all of them: pitch and yaw; roll hangs on the border of the image alone.
    turn = np.linalg.lstsq(
        np.concatenate([np.cross(np.eye(3)[k], first.sight.ray_cam[same] @ R.T) for k in range(3)], axis=0)
        .reshape(3, -1).T,
        (second.sight.ray_cam[same] - first.sight.ray_cam[same] @ R.T).ravel(), rcond=None,
    )[0]  # fmt: skip
    assert (np.rad2deg(np.abs(turn)) < [0.003, 0.003, 0.01]).all()
    # Slots that lost their corner hold a new one, with a number that was never used.
    fresh = second.id[(second.id >= 0) & ~np.isin(second.id, first.id)]
    assert len(fresh) == 0 or fresh.min() > first.id.max()


def test_no_corner_is_taken_where_none_may_be_and_they_are_spread():
    image, usable = texture(1), np.ones((240, 320), bool)
    usable[:, :160] = False
    corners = new_corners(image, usable, np.zeros((0, 2)), 100, 32, 8)
    assert len(corners) >= 20 and corners[:, 0].min() > 155
    buckets = {tuple(b) for b in (corners // 32).astype(int).tolist()}
    assert len(buckets) > 0.8 * len(corners)
    taken = new_corners(image, None, corners, 100, 32, 8)
    gap = np.linalg.norm(taken[:, None] - corners[None], axis=2).min()
    assert gap > 12.0
    assert len(new_corners(np.full((240, 320), 90, np.uint8), None, np.zeros((0, 2)), 100, 32, 8)) == 0


def test_a_track_that_was_found_on_the_road_stays_a_point_of_the_road():
    image, road = texture(3), np.zeros((240, 320), bool)
    road[120:] = True
    tracker = FeatureTracker(1, CONFIG)
    first = tracker.step([image], RIG, np.eye(3), [Scenery(np.ones_like(road), road)])
    used = first.id >= 0
    np.testing.assert_array_equal(first.on_road[used], np.round(first.uv[used, 1]) >= 120)
    # The mask of a later image changes nothing for tracks that go on.
    second = tracker.step([image], RIG, np.eye(3), [Scenery(np.ones_like(road), ~road)])
    same = used & (first.id == second.id)
    assert same.sum() >= 30 and (first.on_road[same] == second.on_road[same]).all()


def test_a_black_image_ends_all_tracks_and_the_next_one_begins_anew():
    image, tracker = texture(2), FeatureTracker(1, CONFIG)
    before = tracker.step([image], RIG, np.eye(3))
    black = tracker.step([np.zeros_like(image)], RIG, np.eye(3))
    assert (before.id >= 0).sum() > 30 and black.num_followed == 0 and not (black.id >= 0).any()
    after = tracker.step([image], RIG, np.eye(3))
    assert (after.id >= 0).sum() > 30 and after.id[after.id >= 0].min() > before.id.max()


def test_points_that_move_on_their_own_are_told_from_the_world():
    """40 of 200 points of a driving camera belong to a car that crosses: those far from their plane go, others stay."""
    rng = np.random.default_rng(3)
    p = np.column_stack([rng.uniform(-8, 8, 200), rng.uniform(-3, 2, 200), rng.uniform(6, 40, 200)])
    R, t = rigid.exp(np.array([0, 0, 0, 0.01, 0.03, 0.0]))[:3, :3], np.array([0.05, 0.0, -1.2])
    q = p @ R.T + t
    q[:40] += [0.0, 0.6, 0.0]
    rays = [x / np.linalg.norm(x, axis=1, keepdims=True) for x in (p, q)]
    rays[1] += 0.3 / 700.0 * rng.normal(size=(200, 3))
    rays[1] /= np.linalg.norm(rays[1], axis=1, keepdims=True)
    kept, direction = moves_with_the_world(*rays, np.full(200, 700.0), R, 2.0, 0)
    assert abs(direction @ t) / np.linalg.norm(t) > np.cos(np.deg2rad(0.3))
    moved_px = 0.6 / np.linalg.norm(q, axis=1) * 700.0
    assert kept[40:].mean() > 0.97
    assert kept[:40][moved_px[:40] > 12.0].mean() < 0.1


@pytest.mark.parametrize(
    "camera",
    [
        PinholeCamera(500.0, 510.0, 319.5, 239.5, 640.0, 480.0),
        KannalaBrandtCamera(196.0, 197.0, 318.0, 241.0, 640.0, 480.0, -0.013, -0.0042, 0.0011, -0.0002),
    ],
)
def test_directions_beside_a_ray_become_pixels(camera):
    """Of every model, to first order: as `project` says, also far from the axis of a fisheye."""
    rng = np.random.default_rng(4)
    uv = np.column_stack([rng.uniform(60, 580, 30), rng.uniform(40, 440, 30)])
    sight = sight_lines(camera, uv)
    assert sight.valid.all()
    np.testing.assert_allclose(np.linalg.norm(sight.ray_cam, axis=1), 1.0, atol=1e-12)
    beside = sight.ray_cam + 1e-4 * rng.normal(size=(30, 3))
    expected = np.asarray(camera.project(3.0 * beside)[0]) - uv
    depth = np.sum(beside * sight.ray_cam, axis=1, keepdims=True)
    found = (sight.pixels @ beside[..., None])[..., 0] / depth
    np.testing.assert_allclose(found, expected, atol=2e-3)
    assert (np.abs(px_per_rad(sight) / float(camera.fx) - 1.0) < 0.8).all()
