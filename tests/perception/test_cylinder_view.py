"""The cylinder of a fisheye: upright things upright, points and boxes there and back, feet on the ground."""

import cv2
import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera, mounted
from semloc_jax.errors import SemlocError
from semloc_jax.perception.cylinder_view import CylinderView, outline
from semloc_jax.perception.ground_contact import SightErrors
from tests.perception.four_fisheyes import four_fisheyes

K = np.array([[196.0, 0.0, 319.5], [0.0, 196.0, 239.5], [0.0, 0.0, 1.0]])
D = np.array([-0.013, -0.004, 0.0, 0.0])


@pytest.fixture(scope="module")
def view():
    """The left camera, which looks 35 deg down."""
    rig = four_fisheyes()
    return CylinderView.of(rig.cameras[1], rig.T_base_cam[1])


def by_opencv(view, p_base):
    """Pixels of the fisheye by OpenCV."""
    p_cam = (np.asarray(p_base) - view.T_base_cam[:3, 3]) @ view.T_base_cam[:3, :3]
    return cv2.fisheye.projectPoints(p_cam.reshape(1, -1, 3), np.zeros(3), np.zeros(3), K, D)[0][0]


def post(x=5.5, y=3.0, height_m=1.0):
    return np.column_stack([np.full(9, x), np.full(9, y), np.linspace(0.0, height_m, 9)])


def test_what_is_upright_stands_in_one_column(view):
    seen = by_opencv(view, post())
    assert np.ptp(seen[:, 0]) > 5.0  # it leans in the fisheye
    uv, valid = view.from_camera(seen)
    assert valid.all()
    assert np.ptp(uv[:, 0]) < 0.01
    assert (np.diff(uv[:, 1]) < 0.0).all()  # higher is further up
    there, shown = view.to_camera(uv)
    assert shown.all()
    np.testing.assert_allclose(there, seen, atol=0.01)
    np.testing.assert_allclose(view.foot(post())[0], uv, atol=0.01)


def test_a_picture_shows_on_the_cylinder_what_the_lens_saw(view):
    picture = np.zeros((480, 640), np.uint8)
    cv2.polylines(picture, [np.rint(by_opencv(view, post())).astype(int)], False, 24, 3)
    v, u = np.nonzero(view.warp(picture, outside=255) == 24)
    expected = view.from_camera(by_opencv(view, post()))[0]
    # Three pixels of a brush, and not the lean of the lens.
    assert u.std() < 1.6 and u.mean() == pytest.approx(expected[0, 0], abs=0.5)
    assert v.min() == pytest.approx(expected[:, 1].min(), abs=3) and v.max() == pytest.approx(expected[0, 1], abs=3)
    assert (view.warp(picture, outside=255)[~view.seen] == 255).all()


def test_a_box_comes_back_around_itself(view):
    box = np.array([300.0, 150.0, 330.0, 210.0]) + 0.5 * (view.cylinder.resolution[0] - 640.0) * np.array([1, 0, 1, 0])
    again = view.box_from_camera(view.box_to_camera(box))
    assert (again[:2] <= box[:2] + 0.2).all() and (again[2:] >= box[2:] - 0.2).all()
    shape, seen = view.to_camera(outline(box))
    assert seen.all()
    np.testing.assert_allclose(view.from_camera(shape)[0], outline(box), atol=0.01)
    with pytest.raises(SemlocError, match="no part of it"):
        view.box_from_camera((9000.0, 0.0, 9010.0, 10.0))


def test_a_foot_meets_the_ground_where_it_stands(view):
    errors = SightErrors()
    for x, y, road_m in ((2.5, 4.0, 0.0), (0.5, 3.0, 0.1), (4.0, 2.5, -0.1)):
        foot = view.from_camera(by_opencv(view, [[x, y, road_m]]))[0][0]
        xy, C, _ = view.ground(foot, errors, road_m=road_m)
        np.testing.assert_allclose(xy, [x, y], atol=1e-3)
        assert np.linalg.eigvalsh(C)[0] > 0.0
    assert not np.isfinite(view.ground(np.array([400.0, 3.0]), errors)[0]).all()


def test_the_covariance_of_a_foot_is_that_of_sampled_pixels_pitch_and_height(view):
    """Errors are made in the fisheye, by OpenCV, and not in the cylinder."""
    rng, place, errors = np.random.default_rng(0), np.array([1.0, 3.2, 0.0]), SightErrors(1.0, 0.3, 0.05)
    C = view.ground(view.from_camera(by_opencv(view, [place]))[0][0], errors)[1]
    pixel = by_opencv(view, [place]) + errors.pixel_px * rng.normal(size=(20_000, 2))
    ray = np.column_stack([cv2.fisheye.undistortPoints(pixel[None], K, D)[0], np.ones(len(pixel))])
    ray = ray @ view.T_base_cam[:3, :3].T
    offset = (place - view.T_base_cam[:3, 3])[:2]
    sight = np.append(offset / np.linalg.norm(offset), 0.0)
    # A pitch about the level axis across the sight.
    turn = np.deg2rad(errors.pitch_deg) * rng.normal(size=(len(ray), 1))
    ray = ray + turn * np.cross(np.cross(sight, [0.0, 0.0, 1.0]), ray)
    height = view.T_base_cam[2, 3] + errors.height_m * rng.normal(size=len(ray))
    xy = view.T_base_cam[:2, 3] + ray[:, :2] * (height / -ray[:, 2])[:, None]
    sampled = np.cov(xy.T)
    axes = np.stack([sight[:2], [-sight[1], sight[0]]])
    np.testing.assert_allclose(np.diag(axes @ C @ axes.T), np.diag(axes @ sampled @ axes.T), rtol=0.12)


def test_gravity_may_lean_and_a_camera_may_look_straight_down():
    camera = PinholeCamera(300.0, 300.0, 319.5, 239.5, 640, 480)
    up = np.array([0.05, -0.03, 1.0])
    view = CylinderView.of(camera, mounted((0.0, 0.0, 1.0), down_deg=10.0), up)
    foot = np.array([5.0, 0.3, 0.0])
    uv, shown = view.foot(np.array([foot, foot + 0.5 * up / np.linalg.norm(up)]))
    assert shown.all() and abs(uv[0, 0] - uv[1, 0]) < 1e-3
    down = CylinderView.of(camera, mounted((0.0, 0.0, 1.0), down_deg=90.0))
    np.testing.assert_allclose(down.T_base_cylinder[:3, 2], [1.0, 0.0, 0.0], atol=1e-12)
    with pytest.raises(SemlocError, match="sees nothing between the horizon"):
        CylinderView.of(camera, mounted((0.0, 0.0, 1.0), down_deg=-70.0))
