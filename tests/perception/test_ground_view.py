"""Ground view: pixels of image and top view that belong together see the same point of the road."""

import numpy as np
import pytest

from semloc_jax.cameras import KannalaBrandtCamera, PinholeCamera
from semloc_jax.errors import SemlocError
from semloc_jax.perception import GroundView


def pose(yaw_deg, pitch_deg, height_m):
    """T_base_cam of a camera that looks `yaw_deg` to the left and `pitch_deg` down."""
    yaw, pitch = np.deg2rad(yaw_deg), np.deg2rad(pitch_deg)
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    T_base_cam = np.eye(4)
    T_base_cam[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T_base_cam[:3, 3] = [1.2, 0.3, height_m]
    return T_base_cam


CAMERAS = {
    "pinhole": PinholeCamera(300.0, 300.0, 199.5, 119.5, 400, 240),
    "fisheye": KannalaBrandtCamera(120.0, 120.0, 199.5, 119.5, 400, 240, -0.01),
}


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, -150.0])
def test_image_and_top_view_agree(name, yaw_deg):
    camera, T_base_cam = CAMERAS[name], pose(yaw_deg, 20.0, 1.5)
    view = GroundView.of(camera, T_base_cam, metres_per_px=0.05, range_m=12.0)
    v, u = np.nonzero(view.visible)
    chosen = np.random.default_rng(0).choice(len(u), 400)
    u, v = u[chosen], v[chosen]
    # Independent way: the top-view pixel in metres, put into the camera by hand.
    scale = 0.05
    p_base = np.stack([(float(view.bev.cy) - v) * scale, (float(view.bev.cx) - u) * scale, 0.0 * u], axis=-1)
    p_cam = (np.linalg.inv(T_base_cam) @ np.concatenate([p_base, np.ones((400, 1))], axis=1).T).T[:, :3]
    np.testing.assert_allclose(view.image_uv[v, u], np.asarray(camera.project(p_cam)[0]), atol=1e-3)
    # Back again at the nearest image pixel: within its footprint of the top-view pixel.
    pixel = np.round(view.image_uv[v, u]).astype(int).clip([0, 0], [399, 239])
    near = np.linalg.norm(p_base[:, :2] - T_base_cam[:2, 3], axis=1) < 6.0
    back = view.bev_uv[pixel[:, 1], pixel[:, 0]] - np.stack([u, v], axis=-1)
    assert np.median(np.abs(back[near])) < 2.0


def test_a_picture_survives_the_way_down_and_back():
    view = GroundView.of(CAMERAS["pinhole"], pose(0.0, 20.0, 1.5), metres_per_px=0.02, range_m=8.0)
    v, u = np.mgrid[:240, :400]
    image = (120 + 60 * np.sin(u / 25) * np.cos(v / 20)).astype(np.uint8)
    back = view.warp_back(view.warp(image))
    inner = (view.bev_uv[..., 0] > 0) & (v < 230) & (u > 10) & (u < 390)
    inner &= np.roll(inner, 12, axis=0)
    assert np.abs(back.astype(float) - image)[inner].mean() < 3.0
    assert (back[view.bev_uv[..., 0] < 0] == 0).all()


def test_a_camera_that_looks_up_is_refused():
    with pytest.raises(SemlocError, match="no pixel of the camera meets the road within 10 m"):
        GroundView.of(CAMERAS["pinhole"], pose(0.0, -40.0, 1.5), range_m=10.0)
