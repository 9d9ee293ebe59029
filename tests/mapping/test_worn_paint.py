"""What wear has cut is one dash or bar again; what is painted apart stays apart."""

from dataclasses import replace

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


ROW = [(10.0 * k, 10.0 * k + 4.0) for k in range(3)]


def faded(start_m, end_m, left_m=0.0, clear=(True, False)):
    return replace(dash(start_m, end_m, left_m), true_ends=clear)


def test_a_dash_seen_from_near_and_from_far_is_one():
    """Headings bend between the looks: two pieces overlap 15 cm apart, each with the end that was seen well."""
    found = whole_again([*(dash(*span) for span in ROW), faded(30.0, 32.6), faded(31.2, 34.0, 0.15, (False, True))])
    assert spans(found) == [*ROW, (30.0, 34.0)]
    assert all(e.true_ends == (True, True) for e in found)
    beside = whole_again([*(dash(*span) for span in ROW), dash(30.0, 32.6), dash(31.2, 34.0, 0.15)])
    assert len(beside) == 5  # two whole ones are never one
    stays = whole_again([*(dash(*span) for span in ROW), dash(30.0, 34.0), faded(33.0, 34.5, 0.1)])
    assert spans(stays) == [*ROW, (30.0, 34.0)]  # what is whole is not stretched by what fades out beside it


@pytest.mark.parametrize(
    "end_m, clear, becomes",
    [
        (33.6, (True, False), (30.0, 34.0)),
        (33.6, (False, True), (29.6, 33.6)),
        (33.6, (False, False), None),  # somewhere within half a metre
        (32.5, (True, False), None),  # a part, and nothing says where the rest was
    ],
)
def test_an_end_that_fades_out_is_where_the_length_of_the_others_puts_it(end_m, clear, becomes):
    others = [dash(*span) for span in ROW]
    found = spans(whole_again([*others, faded(30.0, end_m, clear=clear)]))
    assert found == sorted([*ROW, *([becomes] if becomes else [])])
    assert spans(whole_again([*others[:2], faded(30.0, end_m, clear=clear)])) == ROW[:2]  # two tell no length


def test_no_element_is_no_element():
    assert whole_again([]) == []
