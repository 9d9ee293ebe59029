"""Patches laid over later images: a wall that comes nearer and turns, other light, something else in its place."""

import cv2
import numpy as np
import pytest

from semloc_jax.geometry import rigid
from semloc_jax.perception.patches import cut_out, laid_over
from semloc_jax.perception.tracks import FeatureTracker
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
