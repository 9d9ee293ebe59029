"""The bowl around a car: its shape, where cameras show it, what is seen from outside."""

import doctest

import numpy as np
import pytest

import semloc_jax as sj
from semloc_jax.errors import SemlocError
from semloc_jax.perception.bowl import Bowl, BowlView
from tests.perception.four_fisheyes import four_fisheyes, photographed, road_picture

CAR = (-0.9, 3.7, -1.0, 1.0)


@pytest.fixture(scope="module")
def rig():
    return four_fisheyes()


@pytest.fixture(scope="module", params=[0.0, 90.0, 215.0])
def view(request, rig):
    return BowlView.around(rig, request.param, size_px=(320, 180))


def test_flat_at_the_car_and_a_parabola_beyond():
    bowl = Bowl(CAR, flat_m=3.0, rise_per_m=0.25)
    places = np.array([(0.0, 0.0), (6.7, 0.0), (8.7, 0.5), (1.0, -8.0), (6.7 + 3.0, 1.0 + 4.0)])
    # The last one lies 6 m ahead of the front and 4 m left of the side: 7.21 m away, 4.21 beyond the rim.
    np.testing.assert_allclose(bowl.height(places), [0.0, 0.0, 1.0, 4.0, 0.25 * (np.hypot(6, 4) - 3) ** 2], atol=1e-12)


def test_rays_end_on_the_bowl(view):
    rng = np.random.default_rng(0)
    eye = view.T_base_cam[:3, 3]
    assert eye[2] > view.bowl.height(eye[None, :2])[0] + 1.0
    rays = rng.normal(size=(500, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    met = view.bowl.met_by(eye, rays)
    hit = np.isfinite(met).all(axis=1)
    assert hit[rays[:, 2] < -0.05].all() and not hit[rays[:, 2] > 0.98].any()
    np.testing.assert_allclose(met[hit, 2], view.bowl.height(met[hit, :2]), atol=1e-3)
    along = met[hit] - eye
    np.testing.assert_allclose(along / np.linalg.norm(along, axis=1, keepdims=True), rays[hit], atol=1e-9)


def test_each_pixel_of_a_camera_shows_the_same_place_as_the_view(view, rig):
    """A place on the bowl, projected into the view and into a camera: the table of the view leads there."""
    rng = np.random.default_rng(1)
    xy = rng.uniform((-7.0, -7.0), (10.0, 7.0), (4000, 2))
    p_base = np.column_stack([xy, view.bowl.height(xy)])
    p_view = (p_base - view.T_base_cam[:3, 3]) @ view.T_base_cam[:3, :3]
    uv, valid = (np.asarray(part) for part in view.camera.project(p_view))
    inside = valid & (uv > 1).all(axis=1) & (uv < (318, 178)).all(axis=1)
    checked = 0
    for table, camera, T_base_cam in zip(view.image_uv, rig.cameras, np.asarray(rig.T_base_cam), strict=True):
        at = np.round(uv[inside]).astype(int)
        shown = table[at[:, 1], at[:, 0]]
        expected = np.asarray(camera.project((p_base[inside] - T_base_cam[:3, 3]) @ T_base_cam[:3, :3])[0])
        seen = shown[:, 0] > -1e3
        # Half a pixel of the view is up to some pixels of a picture near the car.
        assert np.median(np.linalg.norm(shown - expected, axis=1)[seen]) < 2.0
        checked += seen.sum()
    assert checked > 200


def test_the_road_is_where_it_is_from_any_side(rig, view):
    """A white bar beside the car, on the side of the view, is white in it, and the road beside the bar is not."""
    side = 1.0 if view.T_base_cam[1, 3] > 0.0 else -1.0
    bar = (0.5, side * 2.6, 2.5, side * 2.3)
    picture = view.stitch(photographed(rig, road_picture(lines=[bar])))
    assert picture.dtype == np.uint8 and picture.shape == (180, 320, 3)
    places = np.array([(1.5, side * 2.45, 0.0), (1.5, side * 1.9, 0.0)])
    uv = np.asarray(view.camera.project((places - view.T_base_cam[:3, 3]) @ view.T_base_cam[:3, :3])[0])
    white, grey = (int(picture[round(float(v)), round(float(u))].mean()) for u, v in uv)
    assert white > 170 > 150 > grey


def test_cameras_on_one_pole_have_no_car(rig):
    with pytest.raises(SemlocError, match="--own-car REAR,FRONT,RIGHT,LEFT"):
        BowlView.around(rig.select(("front",)))


def test_the_example_is_true(rig):
    globs = {"sj": sj, "rig": rig, "images": photographed(rig, road_picture())}
    example = doctest.DocTestParser().get_doctest(sj.BowlView.__doc__, globs, "BowlView", None, None)
    assert doctest.DocTestRunner().run(example).failed == 0
