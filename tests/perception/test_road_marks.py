"""Pieces of a top view as marks: sizes, headings, what is cut, and paint found in a grey picture."""

import numpy as np
import pytest

from semloc_jax.perception.road_marks import CELL_M, RoadMark, binarised, marks_of
from semloc_jax.perception.road_pitch import LaneLine, levelled_points, road_pitch
from semloc_jax.perception.shape_functions import ShapeConfig

SHAPE = (120, 160)


def places():
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.stack([-v, -u], axis=-1) * CELL_M


def test_pieces_have_their_size_heading_and_whether_they_are_whole():
    paint, visible = np.zeros(SHAPE, bool), np.ones(SHAPE, bool)
    paint[20:80, 30:33] = True  # 3 m ahead by 0.15 m
    paint[100:110, 60:120] = True  # 0.5 m by 3 m across
    paint[5:12, 5:11] = True  # 42 cells
    paint[40:60, 150:] = True  # at the border of the view
    dash, stop, cut = sorted(marks_of(paint, visible, places()), key=lambda mark: mark.middle[1], reverse=True)
    assert dash.size_m == pytest.approx((3.0, 0.15), abs=1e-4)
    assert dash.turn_rad == pytest.approx(0.0, abs=1e-6)
    assert stop.size_m == pytest.approx((3.0, 0.5), abs=1e-4)
    assert stop.turn_rad == pytest.approx(np.pi / 2)
    assert [mark.is_whole for mark in (dash, stop, cut)] == [True, True, False]
    visible[80:, 28:36] = False
    (beside,) = (mark for mark in marks_of(paint, visible, places()) if mark.size_m[1] < 0.2)
    assert not beside.is_whole


def test_features_end_with_what_the_shape_drops():
    cells = np.argwhere(np.ones((40, 10), bool)) * CELL_M
    features = RoadMark.of(cells).features(ShapeConfig(num_triples=500))
    np.testing.assert_allclose(features[640:], [2.0, 0.5, 1.0, 0.0], atol=1e-5)
    assert features[:640].sum() == pytest.approx(1.0)


def test_paint_is_found_in_shade_and_broad_bright_places_are_not():
    rng = np.random.default_rng(0)
    grey = np.full(SHAPE, 70.0) + 2.0 * rng.normal(size=SHAPE)
    grey[:, 80:] += 60.0  # the sunny half of the road
    paint = np.zeros(SHAPE, bool)
    paint[10:110, 40:43] = paint[10:110, 120:123] = True
    grey[paint] += 50.0
    found = binarised(grey.clip(0, 255).astype(np.uint8))
    assert found[paint].mean() > 0.95
    assert found[~paint].mean() < 0.02


CAMERA = np.array([1.6, 0.0, 1.4])


def lanes(pitch_rad, noise_m=0.0, curve=0.004):
    """Three lines 3.5 m apart as a level vehicle would see them where its nose dips."""
    rng, lines = np.random.default_rng(1), []
    for y_m in (-5.2, -1.7, 1.8):
        x = np.arange(4.0, 16.0)
        xy = np.column_stack([x, y_m + 0.02 * x + curve * x**2]) + noise_m * rng.normal(size=(len(x), 2))
        lines.append(LaneLine(levelled_points(xy, CAMERA, -pitch_rad), CAMERA))
    return lines


@pytest.mark.parametrize("degrees", [-0.8, 0.0, 0.5])
def test_the_pitch_is_that_which_keeps_lines_parallel(degrees):
    pitch = np.rad2deg(road_pitch(lanes(np.deg2rad(degrees))))
    assert pitch == pytest.approx(degrees, abs=0.1 + 0.1 * abs(degrees))
    noisy = np.rad2deg(road_pitch(lanes(np.deg2rad(degrees), noise_m=0.03)))
    assert noisy == pytest.approx(degrees, abs=0.3)


def test_lines_that_do_not_tell_the_pitch_leave_it_level():
    one = lanes(np.deg2rad(0.5))[:1]
    assert road_pitch([]) == road_pitch(one) == road_pitch([one[0], one[0]]) == 0.0


def test_points_move_as_the_pitch_says():
    xy = np.array([[10.0, 2.0], [5.0, -1.0]])
    away = levelled_points(xy, CAMERA, np.deg2rad(0.5))
    back = levelled_points(away, CAMERA, -np.deg2rad(0.5))
    np.testing.assert_allclose(levelled_points(xy, CAMERA, 0.0), xy, atol=1e-12)
    assert np.all(away[:, 0] < xy[:, 0])  # a nose that dips sees nearer road in the same pixel
    assert np.abs(back - xy).max() < 0.2
