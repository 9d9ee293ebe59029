"""Patches laid over later images: a wall that comes nearer and turns, other light, something else in its place."""

import cv2
import numpy as np
import pytest

from semloc_jax.geometry import rigid
from semloc_jax.perception.patches import cut_out, laid_over
from semloc_jax.perception.tracks import CornerConfig, FeatureTracker
from tests.perception.test_tracks import CONFIG, RIG, texture

SIZE = (320, 240)
CENTRE = np.array([159.5, 119.5])
ROLL = rigid.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.deg2rad(1.0)]))[:3, :3]
NUM = 11


def view(k):
    """Affine part of the homography of a wall that is 5 % nearer in each view, turned by a degree a view."""
    H = np.eye(3)
    H[:2, :2] = 1.05**k * np.linalg.matrix_power(ROLL, k)[:2, :2]
    H[:2, 2] = CENTRE - H[:2, :2] @ CENTRE
    return H


def seen(wall, k):
    return cv2.warpPerspective(wall, view(k), SIZE, flags=cv2.INTER_CUBIC)


def moved(uv, k):
    return uv @ view(k)[:2, :2].T + view(k)[:2, 2]


@pytest.fixture(scope="module")
def wall():
    return texture(4)


def test_a_corner_is_where_it_was_found_after_eleven_images(wall):
    tracker = FeatureTracker(1, CONFIG)
    first = tracker.step([seen(wall, 0)], RIG, np.eye(3))
    for k in range(1, NUM + 1):
        last = tracker.step([seen(wall, k)], RIG, ROLL)
    same = (first.id >= 0) & (first.id == last.id)
    off_px = np.linalg.norm(last.uv[same] - moved(first.uv[same], NUM), axis=1)
    # 71 % nearer at the end: patches were cut out anew on the way, and keep the slip of that moment. Followed from
    # image to image alone these corners end 1.8 px off in the median: what comes nearer draws small windows along.
    assert same.sum() >= 8 and np.median(off_px) < 0.1 and np.percentile(off_px, 90) < 0.25


def test_light_does_not_move_a_patch_and_stretching_is_told(wall):
    uv = np.array([[120.0, 100.0], [200.0, 140.0], [160.0, 60.0]])
    patches = cut_out(seen(wall, 0), uv)
    darker = np.clip(0.6 * seen(wall, 2).astype(float) + 20.0, 0, 255).astype(np.uint8)
    found = laid_over(patches, darker, moved(uv, 2) + [0.8, -0.6])
    again = laid_over(patches._replace(affine=found.affine), darker, found.uv)
    np.testing.assert_allclose(again.uv, moved(uv, 2), atol=0.05)
    np.testing.assert_allclose(again.affine, np.broadcast_to(view(2)[:2, :2], (3, 2, 2)), atol=0.03)
    assert (again.alike > 0.98).all()


def test_a_corner_that_looks_otherwise_is_let_go(wall):
    tracker = FeatureTracker(1, CONFIG)
    first = tracker.step([seen(wall, 0)], RIG, np.eye(3))
    changed = seen(wall, 0)
    changed[:, 170:] = texture(9)[:, 170:]
    second = tracker.step([changed], RIG, np.eye(3))
    same = (first.id >= 0) & (first.id == second.id)
    assert same.sum() >= 20 and second.uv[same, 0].max() < 174.0, "half of a patch is 8 px"
    flat = cut_out(np.full((240, 320), 90, np.uint8), np.array([[100.0, 100.0]]))
    nothing = laid_over(flat, seen(wall, 0), np.array([[100.0, 100.0]]))
    assert np.isfinite(nothing.uv).all() and np.isfinite(nothing.affine).all() and abs(nothing.alike[0]) < 1e-6


def road_from(z_m):
    """The road before a camera 1.4 m over it that went so far ahead, and where its points are seen."""
    rng = np.random.default_rng(6)
    grain = cv2.GaussianBlur(rng.uniform(0, 255, size=(600, 400)).astype(np.float32), (0, 0), 2.0)
    v, u = np.mgrid[0:240, 0:320].astype(np.float32)
    depth_m = np.where(v > 125, 1.4 * 300.0 / np.maximum(v - 119.5, 1.0), 1e3)
    # 20 pixels of grain a metre across the road, 10 along it.
    at = 20.0 * (depth_m * (u - 159.5) / 300.0) + 200.0, 10.0 * (depth_m + z_m)
    image = cv2.remap(grain, *(np.asarray(x, np.float32) for x in at), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.clip((image - 127.5) * 6.0 + 128.0, 0, 255).astype(np.uint8)


def test_perspective_hardly_shifts_what_lies_on_the_road():
    """Three images, 0.5 m of road apart: no affine patch follows perspective, and all of it lies 0.10 px too far down,
    0.4 % of the way; its middle less than half of that."""
    v, u = np.meshgrid([165.0, 170.0, 175.0, 180.0], np.arange(60.0, 261.0, 10.0))
    uv, centre = np.column_stack([u.ravel(), v.ravel()]), np.array([159.5, 119.5])
    distance_m = 1.4 * 300.0 / (uv[:, 1] - centre[1])
    patches, off = cut_out(road_from(0.0), uv), np.array([0.3, -0.3])
    for way_m in (0.5, 1.0, 1.5):
        true = (uv - centre) * (distance_m / (distance_m - way_m))[:, None] + centre
        found = laid_over(patches, road_from(way_m), true + off)
        patches, off = patches._replace(affine=found.affine), found.uv - true
    assert 0.0 < np.median(off[:, 1]) < 0.06 and abs(np.median(off[:, 0])) < 0.03
    assert found.alike.min() > 0.9


def test_the_middle_of_a_patch_says_where_the_corner_is():
    """A disc of 10 px before a wall that goes 1.5 px to the side: all of the patch goes 0.9 px along with the wall."""
    wall, disc = texture(7), texture(8)
    v, u = np.mgrid[0:240, 0:320].astype(np.float32)
    inside = np.clip(5.0 - np.hypot(u - 160.0, v - 120.0), 0.0, 1.0)
    moved_wall = cv2.warpAffine(wall, np.float32([[1, 0, 1.5], [0, 1, 0]]), SIZE, flags=cv2.INTER_CUBIC)
    first, second = ((inside * disc + (1.0 - inside) * behind).astype(np.uint8) for behind in (wall, moved_wall))
    found = laid_over(cut_out(first, np.array([[160.0, 120.0]])), second, np.array([[160.3, 119.8]]))
    assert np.linalg.norm(found.uv[0] - [160.0, 120.0]) < 0.45


def test_a_small_image_fills_its_slots():
    """200 slots in 320 x 240 px: squares of 60 px would give 20 corners."""
    tracker = FeatureTracker(1, CornerConfig())
    assert (tracker.step([texture(4)], RIG, np.eye(3)).id >= 0).sum() > 180
