"""Studs and short dashes are drawn where they stand in a row."""

import cv2
import numpy as np
import pytest

from semloc_jax.mapping.short_dashes import SpotLimits, rows_of_spots
from semloc_jax.mapping.strokes import PaintTrace

LIMITS = SpotLimits(least_share=0.3, shortest=4.8, longest=24.0, widest=14.0, apart=120.0)
ALL = np.ones((400, 700), bool)


def picture(spots, faint=1.0):
    """Share of looks: spots x, y, length, width, turn [cells, deg], drawn eight times finer."""
    fine = np.zeros((3200, 5600), np.uint8)
    for x, y, length, width, turn_deg in spots:
        box = cv2.boxPoints(((8 * x + 3.5, 8 * y + 3.5), (8.0 * length, 8.0 * width), turn_deg))
        cv2.fillPoly(fine, [np.rint(box).astype(np.int32)], 255)
    share = cv2.resize(fine, (700, 400), interpolation=cv2.INTER_AREA).astype(np.float32) / 255.0
    return faint * cv2.GaussianBlur(share, (0, 0), 1.0)


def row(num, turn_deg=20.0, length=12.0, width=6.0, gap=50.0):
    turn = np.deg2rad(turn_deg)
    start = np.array([120.0, 60.0])
    return [(*(start + k * gap * np.array([np.cos(turn), np.sin(turn)])), length, width, turn_deg) for k in range(num)]


@pytest.mark.parametrize("turn_deg", [0.0, 20.0])
def test_a_row_of_spots_is_as_many_dashes_along_the_row(turn_deg):
    spots = row(5, turn_deg)
    found = rows_of_spots(picture(spots, 0.7), ALL, [], LIMITS)
    assert len(found) == 5
    way = np.array([np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))])
    for dash, (x, y, *_) in zip(sorted(found, key=lambda d: d.middle[0, 0]), spots, strict=True):
        np.testing.assert_allclose(dash.middle.mean(axis=0), [x, y], atol=0.3)
        step = dash.middle[-1] - dash.middle[0]
        assert abs(step @ way) / np.linalg.norm(step) > 0.995
        assert dash.length == pytest.approx(12.0, abs=2.0)
        assert dash.width == pytest.approx(6.0, abs=1.5)
        assert dash.is_end == (True, True)


def test_spots_out_of_step_are_a_row_all_the_same():
    """Real rows have gaps of different length."""
    at = [120.0, 150.0, 210.0, 255.0, 330.0]
    found = rows_of_spots(picture([(x, 200.0, 11.0, 8.0, 0.0) for x in at]), ALL, [], LIMITS)
    assert len(found) == 5


@pytest.mark.parametrize(
    "spots",
    [
        row(3),
        [(120, 60, 12, 6, 0), (180, 110, 12, 6, 0), (250, 60, 12, 6, 0), (330, 130, 12, 6, 0)],
        row(5, length=40.0),
        [(120 + 60 * k, 100, 8 + 7 * (k % 2), 5 + 7 * (k % 2), 0) for k in range(5)],
    ],
    ids=["three", "no row", "strokes", "not alike"],
)
def test_what_is_no_row_of_spots_is_none(spots):
    assert rows_of_spots(picture(spots), ALL, [], LIMITS) == []


def test_pieces_of_a_worn_line_and_crumbs_beside_one_are_no_row():
    worn = picture(row(8, 0.0, length=14.0, gap=18.0))
    assert rows_of_spots(worn, ALL, [], LIMITS) == []
    line = PaintTrace(np.array([[60.0, 200.0], [600.0, 200.0]]), 6.0, (True, True))
    crumbs = picture([(330, 200, 560, 6, 0), *((120 + 60 * k, 207, 10, 5, 0) for k in range(6))])
    assert rows_of_spots(crumbs, ALL, [line], LIMITS) == []
