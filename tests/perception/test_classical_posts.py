"""White posts beside a road: found at their borders, at any size of image; nothing else is one."""

import cv2
import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera
from semloc_jax.perception import GroundView
from semloc_jax.perception.classical_posts import find_posts
from tests.perception.test_ground_view import pose


def picture(scale, post_m, height_m=1.0, radius_m=0.06):
    """A meadow with one post at (x, y) [m], its camera 1.6 m above the road, and the pixels of the post."""
    size = round(960 * scale), round(600 * scale)
    camera = PinholeCamera(600.0 * scale, 600.0 * scale, 480 * scale - 0.5, 300 * scale - 0.5, *size)
    T_base_cam = pose(0.0, 3.0, 1.6)
    view = GroundView.of(camera, T_base_cam, 0.05, 35.0)
    x, y = post_m
    corners = np.array([[x, y + s * radius_m, z] for s, z in ((1, 0), (-1, 0), (-1, height_m), (1, height_m))])
    uv = np.asarray(camera.project((corners - T_base_cam[:3, 3]) @ T_base_cam[:3, :3])[0])
    noise = np.random.default_rng(0).normal(0, 4, (round(600 * scale), round(960 * scale), 1))
    image = np.array([40, 75, 60]) + noise
    fine = np.zeros((8 * size[1], 8 * size[0]), np.float32)
    cv2.fillConvexPoly(fine, np.round(8 * uv + 3.5).astype(np.int32), 1.0)
    covered = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)[..., None]
    image = np.clip(image + covered * (215 - image), 0, 255).astype(np.uint8)
    return image, view, uv


@pytest.mark.parametrize("scale", [1.0, 0.5])
@pytest.mark.parametrize("post_m", [(9.0, 5.0), (14.0, -4.0)])
def test_a_post_is_found_between_its_borders(scale, post_m):
    image, view, uv = picture(scale, post_m)
    found = find_posts(image, view)
    rows, columns = np.nonzero(found)
    assert len(rows)
    assert abs(columns.mean() - uv[:, 0].mean()) < 0.6
    assert abs(np.ptp(columns) + 1 - abs(uv[1, 0] - uv[0, 0])) < 1.6
    assert np.ptp(rows) + 1 > 0.8 * np.ptp(uv[:, 1])


@pytest.mark.parametrize("height_m, radius_m", [(0.2, 0.06), (4.0, 0.06), (1.0, 0.4)])
def test_what_is_too_low_too_tall_or_too_wide_is_no_post(height_m, radius_m):
    image, view, _ = picture(0.5, (9.0, 3.0), height_m, radius_m)
    assert not find_posts(image, view).any()


def test_a_post_is_found_before_grass_in_the_sun_and_leaves_are_none():
    image, view, uv = picture(0.5, (9.0, 5.0))
    rng = np.random.default_rng(1)
    meadow = np.abs(image.astype(float) - np.array([40, 75, 60])).max(axis=-1) < 25
    bright = image.copy()
    bright[meadow] = np.clip(np.array([80, 215, 220]) + rng.normal(0, 4, (meadow.sum(), 3)), 0, 255).astype(np.uint8)
    rows, columns = np.nonzero(find_posts(bright, view))
    assert len(rows) and abs(columns.mean() - uv[:, 0].mean()) < 0.6
    # Upright stems and leaves in the sun, as yellow as grass, or as white as a post.
    for colour in ([0.35, 0.95, 1.0], [1.0, 1.0, 1.0]):
        stems = np.repeat(rng.uniform(20, 230, (image.shape[0] // 25 + 1, image.shape[1])), 25, axis=0)
        assert not find_posts((stems[: image.shape[0], :, None] * colour).astype(np.uint8), view).any()
