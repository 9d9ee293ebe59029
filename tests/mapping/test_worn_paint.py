"""What wear has cut is one dash or bar again; what is painted apart stays apart."""

import numpy as np
import pytest

from semloc_jax.mapping.worn_paint import whole_again
from semloc_jax.maps import MapElement


def dash(start_m, end_m, left_m=0.0):
    points = [[start_m, left_m, 0.0], [end_m, left_m, 0.0]]
    return MapElement(f"dash_{start_m}", "lane_marking", points, width_m=0.15, style="dashed")


def bar(start_m, end_m, left_m, width_m=0.45):
    low, high = left_m - 0.5 * width_m, left_m + 0.5 * width_m
    corners = [[start_m, low, 0.0], [end_m, low, 0.0], [end_m, high, 0.0], [start_m, high, 0.0]]
    return MapElement(f"bar_{left_m}_{start_m}", "crosswalk", corners, closed=True)


def spans(elements):
    return sorted((round(e.points[:, 0].min(), 3), round(e.points[:, 0].max(), 3)) for e in elements)


def test_two_pieces_of_a_dash_are_one_as_long_as_the_others():
    whole = [dash(10.0 * k, 10.0 * k + 4.0) for k in range(3)]
    found = whole_again([*whole, dash(30.0, 31.5), dash(32.4, 34.0)])
    assert spans(found) == [(0.0, 4.0), (10.0, 14.0), (20.0, 24.0), (30.0, 34.0)]
    np.testing.assert_allclose([e.width_m for e in found], 0.15)


def test_pieces_of_bars_keep_their_width():
    whole = [bar(0.0, 3.0, left_m) for left_m in (0.0, 0.9, 1.8)]
    found = whole_again([*whole, bar(0.0, 1.1, 2.7), bar(1.3, 3.0, 2.7), bar(0.0, 2.0, 3.6)])
    assert spans(found) == [(0.0, 2.0), *[(0.0, 3.0)] * 4]
    (joined,) = [e for e in found if abs(e.points[:, 1].mean() - 2.7) < 0.1]
    assert np.ptp(joined.points[:, 1]) == pytest.approx(0.45)


@pytest.mark.parametrize("gap_m, left_m", [(1.0, 0.0), (2.0, 0.0), (0.5, 0.3)])
def test_dashes_that_are_painted_so_stay(gap_m, left_m):
    """Metre by metre, with longer gaps, or beside each other."""
    short = [dash((1.0 + gap_m) * k, (1.0 + gap_m) * k + 1.0, left_m * (k % 2)) for k in range(8)]
    assert len(whole_again(short)) == 8
    among_others = [*short, *(dash(40.0 + 10.0 * k, 44.0 + 10.0 * k) for k in range(2))]
    assert len(whole_again(among_others)) == 10


def test_no_element_is_no_element():
    assert whole_again([]) == []
