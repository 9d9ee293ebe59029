"""Pictures of a calibration: horizon and undistorted points lie where independent geometry says."""

import cv2
import numpy as np
import pytest

from semloc_jax.cameras import CylindricalCamera, PinholeCamera, Rig
from semloc_jax.simulation.cameras import front_rig, mounted, surround_rig
from semloc_jax.viz.calibration import calibration_figure, draw_calibration, top_view_figure, undistorted
from semloc_jax.viz.style import to_image


def test_the_horizon_of_a_pitched_camera():
    """A level horizon is seen at cy - f tan(pitch)."""
    camera = PinholeCamera(700.0, 700.0, 479.5, 299.5, 960, 600)
    T = mounted((1.5, 0.0, 1.4), yaw_deg=0.0, down_deg=4.0, roll_deg=0.0)
    picture = draw_calibration(np.zeros((600, 960, 3), np.uint8), camera, T)
    grey = picture[:, 700:900].astype(float)
    level = np.where(np.ptp(grey, axis=2) < 5, grey.mean(axis=2), 0.0).mean(axis=1)
    level[level < 60] = 0.0
    assert np.average(np.arange(600), weights=level) == pytest.approx(299.5 - 700 * np.tan(np.radians(4.0)), abs=0.3)


@pytest.mark.parametrize(
    ("rig", "name", "kind"),
    [(front_rig(), "front", PinholeCamera), (surround_rig(), "left", CylindricalCamera)],
)
def test_undistorted_pictures_show_points_where_their_camera_says(rig, name, kind):
    index = rig.index(name)
    camera, T = rig.cameras[index], np.asarray(rig.T_base_cam[index])
    width, height = camera.resolution
    _, target, T_new = undistorted(np.zeros((height, width, 3), np.uint8), camera, T)
    assert type(target) is kind
    rng = np.random.default_rng(2)
    checked = 0
    for uv in rng.uniform([0.25 * width, 0.4 * height], [0.75 * width, 0.7 * height], (6, 2)):
        ray = np.asarray(camera.unproject(uv)[0])
        p_base = T[:3, :3] @ (7.0 * ray) + T[:3, 3]
        seen, valid = (np.asarray(a) for a in target.project(T_new[:3, :3].T @ (p_base - T_new[:3, 3])))
        if not valid or not (20 < seen[0] < width - 20 and 20 < seen[1] < height - 20):
            continue
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        blob = 255 * np.exp(-((columns - uv[0]) ** 2 + (rows - uv[1]) ** 2) / 18.0)
        picture, _, _ = undistorted(np.dstack([blob] * 3).astype(np.uint8), camera, T)
        weight = (picture[..., 0].astype(float) - 40).clip(0)
        at = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
        np.testing.assert_allclose(at, seen, atol=0.6)
        checked += 1
    assert checked > 3


def test_poles_stand_upright_on_the_cylinder():
    rig = surround_rig()
    T = np.asarray(rig.T_base_cam[1])
    _, target, T_new = undistorted(np.zeros((480, 640, 3), np.uint8), rig.cameras[1], T)
    pole = np.stack([np.full(20, 3.0), np.full(20, 5.0), np.linspace(0.0, 2.5, 20)], axis=1)
    u = np.asarray(target.project((pole - T_new[:3, 3]) @ T_new[:3, :3])[0])[:, 0]
    assert np.ptp(u) < 1e-9


def test_the_top_view_is_metric():
    """A square painted 6 m ahead of the axle, 1 m to the left, is found there."""
    rig = front_rig()
    T = np.asarray(rig.T_base_cam[0])
    corners = np.array([[8.0, 0.7, 0], [8.6, 0.7, 0], [8.6, 1.3, 0], [8.0, 1.3, 0]])
    uv = np.asarray(rig.cameras[0].project((corners - T[:3, 3]) @ T[:3, :3])[0])
    image = cv2.fillPoly(np.zeros((600, 960, 3), np.uint8), [np.round(uv).astype(np.int32)], (255, 0, 0))
    figure = top_view_figure({"front": image}, rig)
    shown = figure.axes[0].images[0]
    left, right, bottom, top = shown.get_extent()
    red = shown.get_array()[..., 0] > 128
    rows, columns = np.nonzero(red & (shown.get_array()[..., 1] < 60))
    height, width = red.shape
    x = top - (rows.mean() + 0.5) / height * (top - bottom)
    y = left - (columns.mean() + 0.5) / width * (left - right)
    assert (x, y) == (pytest.approx(8.3, abs=0.06), pytest.approx(1.0, abs=0.06))
    behind, ahead = figure.axes[0].get_ylim()
    assert -3.0 < behind < -0.5 and ahead > 20.0  # no half of the picture is empty behind a car with a camera in front


def test_a_figure_spells_out_what_was_found():
    rig = front_rig(320, 200)
    image = np.full((200, 320, 3), 90, np.uint8)
    plain = to_image(calibration_figure("front", image, rig.cameras[0], rig.T_base_cam[0]))
    words = to_image(calibration_figure("front", image, rig.cameras[0], rig.T_base_cam[0], findings=("a", "b", "c")))
    assert words.shape[0] > plain.shape[0] and words.shape[1] == plain.shape[1]
    assert isinstance(rig, Rig)
