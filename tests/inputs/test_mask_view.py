"""Masks that are smaller than their images, and moved, are seen by a camera to which the same points project."""

import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Frame, open_drive
from semloc_jax.inputs.mask_source import MaskSource, is_eyes, is_network, made_of_images, mask_source
from semloc_jax.perception import load_class_table

RIG = Rig([PinholeCamera(800.0, 800.0, 639.5, 359.5, 1280, 720)], np.eye(4)[None], ["front"])


def small(frame, camera):
    return np.ones((180, 320), np.uint8)


def test_the_camera_of_small_masks_sees_the_same_points():
    source = MaskSource(
        "net", load_class_table("lane_paint"), ("front",), small, {"front": (0.5, -1.0)}, {"front": (320, 180)}
    )
    (camera,) = source.seen_by(RIG).cameras
    (seen,) = source.segment_rig(RIG).cameras
    assert seen.resolution == (320, 180) and camera.resolution == (640, 360)
    p_cam = np.array([[1.0, 0.5, 4.0], [-3.0, 1.0, 9.0]])
    uv = 800.0 * p_cam[:, :2] / p_cam[:, 2:] + [639.5, 359.5]
    in_mask = (uv + 0.5) / 4 - 0.5 + [0.5, -1.0]
    np.testing.assert_allclose(np.asarray(seen.project(p_cam)[0]), in_mask, atol=1e-9)
    np.testing.assert_allclose(np.asarray(camera.project(p_cam)[0]), 2.0 * (in_mask + 0.5) - 0.5, atol=1e-9)


def test_moving_objects_are_drawn_in_the_size_of_the_masks():
    dynamic = np.zeros((720, 1280), bool)
    dynamic[401, 800] = True
    frame = Frame(0, "0", 0.0, "", RIG, {}, lambda camera: dynamic)
    (mask,) = MaskSource("net", load_class_table("lane_paint"), ("front",), small).masks(frame)
    assert np.argwhere(mask == 255).tolist() == [[200, 400], [200, 401], [201, 400], [201, 401]]


def test_masks_of_one_camera_leave_the_others_out(data_dir):
    folder = data_dir / "pandaset_002"
    if not folder.is_dir():
        pytest.skip(f"no pandaset_002 in {data_dir}")
    drive = open_drive(folder)
    source = mask_source("masks_twinlite_front", drive, offset_px=(0.0, 0.0))
    assert source.cameras == ("front_camera",)
    assert source.seen_by(drive.rig.select(source.cameras)).cameras[0].resolution == (640, 360)
    assert source.masks(drive.frames[50])[0].shape == (360, 640)


def test_eyes_that_ship_are_known_by_name():
    """Both make masks of images; a folder of such a name would have to be given by its path."""
    for name in ("net", "net:garage", "ipm:net:garage", "mine.weights"):
        assert is_eyes(name) and is_network(name) and made_of_images(name)
    assert not any(map(is_eyes, ("net:lot", "sem_net", "classical")))
