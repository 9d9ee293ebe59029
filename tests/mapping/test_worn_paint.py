"""What wear has cut is one dash or bar again; what is painted apart stays apart."""

import numpy as np
import pytest

from semloc_jax.mapping.worn_paint import pieces_joined, rows_completed
from semloc_jax.maps import MapElement


def dash(start_m, end_m, left_m=0.0):
    points = [[start_m, left_m, 0.0], [end_m, left_m, 0.0]]
    return MapElement(f"dash_{start_m}", "lane_marking", points, width_m=0.15, style="dashed")


def bar(start_m, end_m, left_m, width_m=0.45, label="crosswalk"):
    low, high = left_m - 0.5 * width_m, left_m + 0.5 * width_m
    corners = [[start_m, low, 0.0], [end_m, low, 0.0], [end_m, high, 0.0], [start_m, high, 0.0]]
    return MapElement(f"bar_{left_m}_{start_m}", label, corners, closed=True)


def whole_again(elements):
    return rows_completed(pieces_joined(elements))


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
    assert spans(found) == [(0.0, 3.0)] * 5
    (joined,) = [e for e in found if abs(e.points[:, 1].mean() - 2.7) < 0.1]
    assert np.ptp(joined.points[:, 1]) == pytest.approx(0.45)


@pytest.mark.parametrize("gap_m, left_m", [(1.0, 0.0), (2.0, 0.0), (0.5, 0.3)])
def test_dashes_that_are_painted_so_stay(gap_m, left_m):
    """Metre by metre, with longer gaps, or beside each other."""
    short = [dash((1.0 + gap_m) * k, (1.0 + gap_m) * k + 1.0, left_m * (k % 2)) for k in range(8)]
    assert len(whole_again(short)) == 8
    among_others = [*short, *(dash(40.0 + 10.0 * k, 44.0 + 10.0 * k) for k in range(2))]
    assert len(whole_again(among_others)) == 10


def test_a_bar_that_its_row_completes_keeps_the_name_of_what_is_left_of_it():
    whole, piece = [bar(0.0, 3.0, left_m) for left_m in (0.0, 0.9, 1.8)], bar(0.0, 1.2, 2.7)
    found = {element.id: element for element in whole_again([*whole, piece])}
    assert np.ptp(found[piece.id].points[:, 0]) == pytest.approx(3.0)


def test_no_element_is_no_element():
    assert whole_again([]) == []


def test_pieces_reach_from_border_to_border_of_a_crosswalk():
    """A worn end, a middle that is gone with one end, a short piece drawn askew: as long as the bars beside."""
    whole = [bar(0.1 * left_m, 3.0 + 0.1 * left_m, left_m) for left_m in (0.0, 1.0, 2.0, 6.0)]
    worn = [bar(0.3, 1.6, 3.0), bar(0.4, 1.1, 4.0), bar(1.7, 2.2, 4.0), bar(2.0, 3.5, 5.0)]
    found = whole_again([*whole, *worn])
    at = {round(e.points[:, 1].mean()): (e.points[:, 0].min(), e.points[:, 0].max()) for e in found}
    assert len(found) == len(at) == 7
    for left_m, ends_m in at.items():
        np.testing.assert_allclose(ends_m, (0.1 * left_m, 3.0 + 0.1 * left_m), atol=0.06)


def test_what_is_no_piece_of_a_bar_between_borders_stays():
    """Beyond the border, of another width, turned, or with too few whole bars around it."""
    whole = [bar(0.0, 3.0, left_m) for left_m in (0.0, 1.0, 2.0)]
    turned = MapElement("turned", "crosswalk", bar(0.0, 1.0, 3.0).points[:, [1, 0, 2]], closed=True)
    for piece in (bar(2.5, 4.0, 3.0), bar(0.5, 1.5, 3.0, width_m=0.2), turned):
        assert whole_again([*whole, piece])[-1] is piece
    piece = bar(0.5, 1.5, 2.0)
    assert whole_again([*whole[:2], piece])[-1] is piece


def test_a_short_piece_drawn_askew_is_joined_along_the_longer_one():
    """Two degrees: over three metres its own line leaves that of the bar by more than paint is apart."""
    long, short = bar(0.0, 1.5, 0.0), bar(2.1, 3.0, 0.0)
    c, s = np.cos(0.05), np.sin(0.05)
    middle = short.points.mean(axis=0)
    askew = short.with_points((short.points - middle) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + middle)
    whole = [bar(0.0, 3.0, left_m) for left_m in (20.0, 21.0)]
    for pieces in ([askew, long], [long, askew]):
        assert len(whole_again([*pieces, *whole])) == 3


def test_a_stop_line_that_is_whole_again_says_how_long_the_next_one_is():
    """Most of what is near the first one are pieces; the second one, farther away, is judged by a whole one."""
    of = [bar(*ends_m, left_m, 0.3, "stop_line") for *ends_m, left_m in ((0.0, 1.0, 0.0), (1.25, 2.6, 0.0))]
    of += [bar(*ends_m, left_m, 0.3, "stop_line") for *ends_m, left_m in ((0.0, 0.7, 17.0), (1.3, 2.6, 17.0))]
    of += [bar(0.0, 2.6, left_m, 0.3, "stop_line") for left_m in (34.0, 56.0)]
    assert spans(of[:2]) == spans(whole_again(of[:2]))
    assert spans(whole_again(of)) == [(0.0, 2.6)] * 4


def test_pieces_of_a_speed_bump_are_one_and_humps_set_apart_stay():
    pieces = [bar(*ends_m, 0.0, 0.34, "speed_bump") for ends_m in ((0.0, 1.6), (2.13, 4.9), (5.15, 5.5))]
    assert spans(whole_again(pieces)) == [(0.0, 5.5)]
    humps = [bar(*ends_m, 0.0, 0.34, "speed_bump") for ends_m in ((0.0, 1.8), (2.6, 4.4))]
    beside = [bar(0.0, 1.8, left_m, 0.34, "speed_bump") for left_m in (0.0, 0.5)]
    assert len(whole_again(humps)) == len(whole_again(beside)) == 2
