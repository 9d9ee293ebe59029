"""Explicit shapes in masks: drawn by OpenCV at known sub-pixel places, found again."""

import cv2
import numpy as np
import pytest

from semloc_jax.perception import load_class_table
from semloc_jax.perception.primitives import primitives_of

TABLE = load_class_table("drive")
LANE, POLE, SIGN, VEHICLE = 10, 20, 21, 7
FINE = 1 << 6


def drawn(*parts):
    """A mask with polygons, each filled where its pixels' centres lie inside."""
    large = 8
    mask = np.zeros((300, 400), np.uint8)
    for class_id, outline in parts:
        layer = np.zeros((300 * large, 400 * large), np.uint8)
        fine = (np.asarray(outline, np.float64) + 0.5) * large - 0.5
        cv2.fillPoly(layer, [np.round(fine * FINE).astype(np.int32)], 1, shift=6)
        mask[layer[large // 2 :: large, large // 2 :: large] > 0] = class_id
    return mask


def turned(points, angle_rad, centre):
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray(points) @ np.array([[c, s], [-s, c]]) + centre


def polygon(num, radius, angle_rad, centre):
    at = 2 * np.pi * np.arange(num) / num
    return turned(radius * np.stack([np.cos(at), np.sin(at)], axis=1), angle_rad, centre)


@pytest.mark.parametrize(("num", "shape"), [(3, "triangle"), (4, "rectangle")])
def test_corners_of_signs_are_found_within_their_covariance(num, shape):
    """Twenty signs of 20 to 36 px in any pose: corners to a third of a pixel, errors as stated."""
    rng = np.random.default_rng(num)
    off, scaled = [], []
    for _ in range(20):
        truth = polygon(num, rng.uniform(14, 24), rng.uniform(0, 6), rng.uniform(60, 200, 2))
        (sign,) = primitives_of(drawn((SIGN, truth)), TABLE).signs
        assert sign.shape == shape
        order = np.argmin(np.linalg.norm(sign.corners[:, None] - truth[None], axis=2), axis=1)
        assert sorted(order) == list(range(num))
        error = sign.corners - truth[order]
        off.append(error)
        scaled += [e @ np.linalg.solve(C, e) / 2.0 for e, C in zip(error, sign.covariance, strict=True)]
    assert np.sqrt(np.mean(np.square(off))) < 0.33
    assert 0.05 < np.mean(scaled) < 1.5


def test_circles_have_a_centre_and_a_radius():
    rng = np.random.default_rng(2)
    for _ in range(5):
        radius, centre = rng.uniform(10, 20), rng.uniform(60, 200, 2)
        (sign,) = primitives_of(drawn((SIGN, polygon(90, radius, 0.0, centre))), TABLE).signs
        assert sign.shape == "circle"
        assert np.abs(sign.centre - centre).max() < 0.2
        assert abs(sign.radius_px - radius) < 0.3


def test_a_lane_is_a_curve_through_its_middle():
    """The middle of a bent lane to a quarter of a pixel, its covariance no smaller than its error."""
    v = np.linspace(120.0, 280.0, 60)
    middle = 150.0 + 0.4 * (v - 120.0) + 0.001 * (v - 120.0) ** 2
    half = np.linspace(1.5, 9.0, 60)
    outline = np.vstack([np.stack([middle - half, v], axis=1), np.stack([middle + half, v], axis=1)[::-1]])
    (lane,) = primitives_of(drawn((LANE, outline)), TABLE).lanes
    rows = np.linspace(lane.first, lane.last, 12)
    off = lane.column(rows) - np.interp(rows, v, middle)
    assert np.abs(off).max() < 0.25
    assert np.abs(lane.slope(rows) - (0.4 + 0.002 * (rows - 120.0))).max() < 0.02
    assert np.sqrt(np.mean(off**2 / np.diagonal(lane.covariance_across(rows)))) < 1.5
    assert np.allclose(
        lane.width_across(rows) * np.hypot(1.0, lane.slope(rows)), 2 * np.interp(rows, v, half), atol=0.7
    )


def test_a_post_is_a_line_whose_ends_count_where_they_are_seen():
    post = [[98.2, 60.0], [102.2, 60.0], [106.7, 200.0], [102.7, 200.0]]
    (lamp,) = primitives_of(drawn((POLE, post)), TABLE).lamps
    assert lamp.has_end == (True, True)
    np.testing.assert_allclose(lamp.axis.column(np.array([60.0, 200.0])), [100.2, 104.7], atol=0.15)
    np.testing.assert_allclose(lamp.rows, [200.0, 60.0], atol=0.6)
    car = [[80.0, 190.0], [140.0, 190.0], [140.0, 240.0], [80.0, 240.0]]
    found = primitives_of(drawn((POLE, post), (VEHICLE, car)), TABLE)
    assert found.lamps[0].has_end == (False, True)
    assert found.is_hidden(np.array([[100.0, 220.0], [100.0, 120.0]])).tolist() == [True, False]


def test_what_is_cut_or_bent_is_no_shape():
    """A sign behind a car, an arm on a mast, paint across the view."""
    sign = polygon(4, 20.0, 0.4, (200.0, 100.0))
    car = [[190.0, 100.0], [260.0, 100.0], [260.0, 150.0], [190.0, 150.0]]
    assert not primitives_of(drawn((SIGN, sign), (VEHICLE, car)), TABLE).signs
    arm = [[50.0, 100.0], [180.0, 92.0], [180.0, 96.0], [50.0, 104.0]]
    assert not primitives_of(drawn((POLE, arm)), TABLE).lamps
    stop = [[50.0, 250.0], [300.0, 246.0], [300.0, 256.0], [50.0, 260.0]]
    assert not primitives_of(drawn((LANE, stop)), TABLE).lanes
