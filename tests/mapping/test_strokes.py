"""Strokes of paint: read across as an independent interpolation reads; whole where masks miss a part of the paint."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from semloc_jax.mapping.stroke_profiles import paint_across
from semloc_jax.mapping.strokes import find_strokes


@pytest.mark.parametrize("angle_deg", [0.0, 37.0, 90.0, 161.0])
def test_paint_across_a_place_is_that_of_scipy(angle_deg):
    rng = np.random.default_rng(3)
    share = cv2.GaussianBlur(rng.random((90, 120)).astype(np.float32), (0, 0), 2.0)
    place, ahead = np.array([60.3, 44.7]), np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    left, reach = np.array([-ahead[1], ahead[0]]), 12.0
    offsets, along = np.arange(-reach, reach + 0.25, 0.5), np.arange(-2.0, 2.5)
    x, y = np.moveaxis(place + offsets[:, None, None] * left + along[None, :, None] * ahead, -1, 0)
    expected = map_coordinates(share, [y, x], order=1).mean(axis=1)
    np.testing.assert_allclose(paint_across(share, place, ahead, reach), expected, atol=1e-3)


def dash(*parts: tuple[int, int, float]) -> np.ndarray:
    """A picture of the road with one dash, 6 cells wide; parts are first cell, last cell, share of the looks."""
    share = np.zeros((80, 400), np.float32)
    for first, last, shown in parts:
        share[37:43, first:last] = shown
    return cv2.GaussianBlur(share, (0, 0), 1.0)


def ends_of(share: np.ndarray) -> list[tuple[float, float, tuple[bool, bool]]]:
    """First and last x of every stroke, and whether these are ends of paint."""
    found = []
    for stroke in find_strokes(share, np.ones(share.shape, bool)):
        x, is_end = stroke.middle[[0, -1], 0], stroke.is_end
        found.append((x[0], x[1], is_end) if x[0] < x[1] else (x[1], x[0], is_end[::-1]))
    return found


@pytest.mark.parametrize("middle_share", [0.3, 0.9])
def test_a_dash_is_one_stroke_where_most_looks_miss_its_middle(middle_share):
    """4 m of a cell of 2.5 cm: 1.2 m seen well, 1.8 m seen in three of ten looks, 1 m seen well."""
    ((first, last, is_end),) = ends_of(dash((100, 148, 0.95), (148, 220, middle_share), (220, 260, 0.95)))
    assert is_end == (True, True)
    assert (first, last) == pytest.approx((99.5, 259.5), abs=1.0)


def test_a_dash_ends_where_it_ends_though_few_looks_show_its_end():
    ((first, last, is_end),) = ends_of(dash((100, 150, 0.35), (150, 260, 0.95)))
    assert is_end == (True, True)
    assert (first, last) == pytest.approx((99.5, 259.5), abs=1.0)


def test_bare_road_parts_two_dashes():
    found = sorted(ends_of(dash((60, 160, 0.9), (200, 330, 0.9))))
    assert [is_end for *_, is_end in found] == [(True, True)] * 2
    np.testing.assert_allclose([f[:2] for f in found], [(59.5, 159.5), (199.5, 329.5)], atol=1.0)


def test_a_streak_that_one_look_shows_does_not_make_a_dash_longer():
    share = dash((100, 200, 0.95))
    streak = np.zeros_like(share)
    streak[40, 200:320] = 1.0
    ((first, last, is_end),) = ends_of(np.maximum(share, cv2.GaussianBlur(streak, (0, 0), 1.0) * 0.6))
    assert is_end == (True, True)
    assert (first, last) == pytest.approx((99.5, 199.5), abs=2.0)
