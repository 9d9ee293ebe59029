"""Strokes of a top view: widths and ends as painted, and many strokes at once come out as each alone."""

from functools import partial

import cv2
import numpy as np
import pytest

from semloc_jax.perception.paint_profiles import THIN, find_ridges, lookup, measure_profiles
from semloc_jax.perception.paint_strokes import find_strokes

METRES_PER_PX = 0.05
WIDTH_M = 0.12
FINE = 8
"""The picture is painted this many times finer, then averaged."""


def top_view(*lines_m):
    """A noisy road of 20 m x 20 m with lines 0.12 m wide through points [n 2] in metres, float32[400 400]."""
    fine = np.zeros((400 * FINE, 400 * FINE), np.uint8)
    for line in lines_m:
        # Corners of fine pixels: the centre of the coarse pixel 0 lies at 0 m.
        at = np.round((np.asarray(line) / METRES_PER_PX + 0.5) * FINE - 0.5).astype(np.int32)
        cv2.polylines(fine, [at], False, 255, round(WIDTH_M / METRES_PER_PX * FINE))
    covered = cv2.resize(fine.astype(np.float32) / 255, (400, 400), interpolation=cv2.INTER_AREA)
    road = 80.0 + np.random.default_rng(0).normal(0, 2.0, covered.shape).astype(np.float32)
    return road + covered * np.float32(120.0)


STRAIGHT = [(3.0, 4.0), (3.0, 7.0)]
ALONG_M = np.linspace(2.0, 17.0, 60)
BEND = np.stack([9.0 + 0.01 * (ALONG_M - 10.0) ** 2, ALONG_M], axis=-1)
SLANTED = [(14.0, 5.0), (17.0, 6.0)]


def strokes_of(grey, columns=slice(None), max_scatter_m=np.inf):
    """Strokes from the ridges whose places lie in some columns."""
    visible = np.ones(grey.shape, bool)
    uv, normal = find_ridges(grey, visible, THIN, METRES_PER_PX)
    inside = np.isin(uv[:, 0], np.arange(grey.shape[1])[columns])
    brightness = partial(lookup, grey)
    ridges = measure_profiles(brightness, uv[inside], normal[inside], THIN.max_half_width_m, METRES_PER_PX)
    ridges = ridges.at(ridges.contrast > 0.3)
    return find_strokes(brightness, ridges, THIN.max_half_width_m, METRES_PER_PX, max_scatter_m)


@pytest.fixture(scope="module")
def grey():
    return top_view(STRAIGHT, BEND, SLANTED)


def test_strokes_are_as_wide_and_long_as_painted(grey):
    strokes = strokes_of(grey)
    assert [round(stroke.width_m, 1) for stroke in strokes] == [0.1] * len(strokes)
    for (start, end), of in ((STRAIGHT, slice(0, 100)), (SLANTED, slice(260, 400))):
        (stroke,) = strokes_of(grey, of)
        assert abs(stroke.length_m - np.hypot(*np.subtract(end, start)) - WIDTH_M) < 0.25  # OpenCV paints round ends
        assert abs(stroke.width_m - WIDTH_M) < 0.5 * METRES_PER_PX
        np.testing.assert_allclose(stroke.middle * METRES_PER_PX, np.mean([start, end], axis=0), atol=0.1)
    # Cut in two; each half goes on 0.5 m over the cut.
    painted_m = sum(stroke.length_m for stroke in strokes_of(grey, slice(100, 260))) - 1.0
    assert abs(painted_m - np.hypot(*np.diff(BEND, axis=0).T).sum() - WIDTH_M) < 0.25


def test_many_strokes_at_once_are_those_found_alone(grey):
    together = strokes_of(grey)
    alone = [stroke for of in ((0, 100), (100, 260), (260, 400)) for stroke in strokes_of(grey, slice(*of))]
    assert len(together) == len(alone) == 4
    for stroke in together:
        (own,) = [other for other in alone if np.hypot(*(other.middle - stroke.middle)) < 1e-6]
        np.testing.assert_allclose(own.uv, stroke.uv, atol=1e-9)
        assert own.painted.tolist() == stroke.painted.tolist()
        for name in ("width_m", "length_m", "contrast", "scatter_m", "width_scatter", "rise_m"):
            assert getattr(own, name) == pytest.approx(getattr(stroke, name), abs=1e-6), name


def test_points_on_no_curve_are_left_out_and_the_others_stay(grey):
    zigzag = [(14.0 + 0.12 * (i % 2), 9.0 + 0.1 * i) for i in range(40)]
    crooked = top_view(STRAIGHT, zigzag)
    found, smooth = strokes_of(crooked), strokes_of(crooked, max_scatter_m=0.01)
    assert max(stroke.scatter_m for stroke in found) > 0.01
    assert [stroke.uv.tolist() for stroke in smooth] == [
        stroke.uv.tolist() for stroke in found if stroke.scatter_m <= 0.01
    ]
    assert smooth


def test_a_road_without_ridges_has_no_strokes():
    assert strokes_of(np.full((60, 60), 80.0, np.float32)) == []
