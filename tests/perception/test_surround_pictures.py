"""Pictures of four cameras as one top view: spots where they are, quiet seams, what does not fit is said."""

import doctest

import cv2
import numpy as np
import pytest
from scipy.stats import norm

import semloc_jax as sj
from semloc_jax.errors import SemlocError
from semloc_jax.maps import map_from_arrays
from semloc_jax.perception.blind_pixels import blind_pixels
from semloc_jax.perception.camera_order import belonging
from semloc_jax.perception.colour_balance import ColourBalance
from semloc_jax.perception.surround import SurroundView, own_car
from semloc_jax.perception.surround_quality import overlap_matches, seam_step
from semloc_jax.perception.surveyed_paint import corner_errors
from semloc_jax.perception.view_tables import seam_weights, strongest_two
from tests.perception.four_fisheyes import four_fisheyes, photographed, road_picture, texel

BARS = [(x - 0.06, y0, x + 0.06, y0 + side * 3.0) for x in (-3.0, 0.0, 3.0, 5.5) for side, y0 in ((1, 1.8), (-1, -1.8))]
GAINS = np.array([1.0, 0.8, 1.15, 0.95])


@pytest.fixture(scope="module")
def rig():
    return four_fisheyes()


@pytest.fixture(scope="module")
def road():
    return road_picture(lines=BARS)


@pytest.fixture(scope="module")
def images(rig, road):
    return photographed(rig, road)


@pytest.fixture(scope="module")
def view(rig):
    return SurroundView.around(rig, 10.0, 0.02)


def true_top(view, road):
    v, u = np.mgrid[: view.seen.shape[1], : view.seen.shape[2]]
    x = view.T_base_bev[0, 3] + (float(view.bev.cy) - v) / float(view.bev.fx)
    y = view.T_base_bev[1, 3] + (float(view.bev.cx) - u) / float(view.bev.fx)
    uv = texel(np.stack([x, y], axis=-1)).astype(np.float32)
    return cv2.remap(cv2.blur(road, (3, 3)), uv, None, cv2.INTER_LINEAR)


def test_the_top_view_shows_the_road_as_it_is(view, images, road):
    top, truth = view.stitch(images), true_top(view, road)
    shown = view.seen.any(axis=0)
    off = np.abs(top.astype(float) - truth)[shown]
    assert np.median(off) < 6.0
    assert np.corrcoef(top[shown].ravel(), truth[shown].ravel())[0, 1] > 0.9
    assert (top[~shown] == 0).all() and not shown[250, 250]  # the own car is left blank
    rear, front, right, left = own_car(four_fisheyes())
    assert (rear, front, right, left) == pytest.approx((-0.9, 3.7, -1.0, 1.0))


def test_gains_of_the_cameras_are_found(view, images):
    other = [np.clip(image * gain, 0, 255).astype(np.uint8) for image, gain in zip(images, GAINS, strict=True)]
    found = view.balance(other)
    # What was multiplied is divided out again, up to a factor that all cameras share.
    common = found.gain * GAINS[:, None] + found.offset / 110.0
    np.testing.assert_allclose(common / common.mean(axis=0), 1.0, atol=0.03)
    plain, mended = (seam_step(view, view.stitch(other, balance=b))[0] for b in (ColourBalance.none(4), found))
    assert mended < plain


def test_a_blend_hides_a_step_that_a_cut_shows(rig, images):
    steps = {}
    for blend in ("gaussian", "linear", "hard"):
        own = SurroundView.around(rig, 10.0, 0.02, blend=blend)
        darker = [images[0], (images[1] * 0.7).astype(np.uint8), *images[2:]]
        steps[blend] = seam_step(own, own.stitch(darker, balance=ColourBalance.none(4)))
    assert steps["hard"][0] > steps["hard"][1] + 8.0
    for blend in ("gaussian", "linear"):
        assert steps[blend][0] < steps[blend][1] + 4.0


def test_weights_follow_the_normal_distribution_across_a_seam():
    seen, best = np.ones((2, 40, 200), bool), np.zeros((40, 200), int)
    best[:, 100:] = 1
    weights = seam_weights(seen, best, "gaussian", 12.0)
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-6)
    np.testing.assert_allclose(weights[1, 20], norm.cdf((np.arange(200) - 99.5) / 12.0), atol=0.01)
    pair, share = strongest_two(weights)
    assert share.max() <= 0.5 and pair[0, 0, 10] == 0 and pair[0, 0, 190] == 1


def test_mounts_that_are_off_show_as_millimetres_between_cameras(rig, images, view):
    right = overlap_matches(view, images)
    assert len(right.apart_m) > 20 and np.median(right.apart_m) < 0.02
    tilted = SurroundView.around(four_fisheyes(pitch_deg=36.5), 10.0, 0.02)
    wrong = overlap_matches(tilted, images)
    assert np.median(wrong.apart_m) > 3.0 * np.median(right.apart_m)


def test_surveyed_corners_are_off_by_as_much_as_the_pose(view, images):
    lines = [("slot_line", [[(a + c) / 2, b, 0], [(a + c) / 2, d, 0]], {"width_m": 0.12}) for a, b, c, d in BARS]
    slots = [
        ("parking_slot", [[x, s * 1.8, 0], [x + 3.0, s * 1.8, 0], [x + 3.0, s * 4.8, 0], [x, s * 4.8, 0]])
        for s in (1, -1)
        for x in (-3.0, 0.0)
    ]
    world = map_from_arrays([*lines, *slots])
    top = view.stitch(images)
    found = corner_errors(top, view, world.elements, np.eye(4))
    assert len(found) >= 3
    assert np.median([np.linalg.norm(c.off_m) for c in found]) < 0.008
    moved = corner_errors(top, view, world.elements, sj.planar_pose(0.04, 0.03))
    np.testing.assert_allclose(np.median([c.off_m for c in moved], axis=0), [0.04, 0.03], atol=0.008)


def test_exchanged_cameras_are_recognised(view, images):
    assert belonging(view, [images]).better_order is None
    exchanged = belonging(view, [[images[0], images[3], images[2], images[1]]])
    assert exchanged.better_order == (0, 3, 2, 1)
    other_road = photographed(four_fisheyes(), road_picture(seed=1))
    assert belonging(view, [[images[0], other_road[1], images[2], other_road[3]]]).contradicts


def test_what_is_black_at_the_rim_in_all_pictures_is_blind(images):
    dark = [image.copy() for image in images[:2]]
    for image in dark:
        image[:40] = 3
        image[200:230, 300:330] = 0  # dark things in the middle are shadows
    found = blind_pixels(dark)
    assert found[:40].all() and not found[45:].any()


def test_pictures_of_another_number_or_size_are_refused(view, images):
    with pytest.raises(SemlocError, match="given 3 pictures; expected one for each of 4 cameras"):
        view.stitch(images[:3])
    with pytest.raises(SemlocError, match="picture 1 has 320x240 px; the calibration says 640x480"):
        view.stitch([images[0], images[1][::2, ::2], *images[2:]])


def test_one_camera_is_a_top_view_too(rig, images):
    alone = SurroundView.around(rig.select(["front"]), 10.0, 0.05)
    top = alone.stitch(images[:1])
    assert (top[alone.seen[0]] > 0).mean() > 0.99 and not top[~alone.seen[0]].any()
    assert seam_step(alone, top) == pytest.approx((np.nan, np.nan), nan_ok=True)


def test_where_cameras_contradict_each_other_one_is_shown_alone(view, images):
    ghost = [image.copy() for image in images]
    ghost[0][:] = 250
    plain, aware = (view.stitch(ghost, balance=ColourBalance.none(4), height_aware=how) for how in (False, True))
    mixed = (view.weights.max(axis=0) > 0.55) & (view.weights.max(axis=0) < 0.8) & (view.weights[0] > 0.2)
    between = [((top[mixed].mean(axis=1) > 140) & (top[mixed].mean(axis=1) < 220)).mean() for top in (plain, aware)]
    assert between[0] > 0.5 and between[1] < 0.25


def test_the_example_is_true(rig, images):
    masks = [np.ones((480, 640), np.uint8)] * 4
    globs = {"sj": sj, "rig": rig, "images": images, "masks": masks}
    example = doctest.DocTestParser().get_doctest(sj.SurroundView.__doc__, globs, "SurroundView", None, None)
    assert doctest.DocTestRunner().run(example).failed == 0
