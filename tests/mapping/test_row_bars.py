"""Bars along the entrance of a row of slots come from all looks along them, where one is due."""

import numpy as np

from semloc_jax.mapping.row_bars import with_bars
from semloc_jax.mapping.slot_rows import draw_rows
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

WAY = np.stack([np.linspace(-20.0, 40.0, 121), np.full(121, -3.0)], axis=1)
STEP_M, DEPTH_M, WIDTH_M, REACH_M = 2.5, 5.2, 0.12, 0.7


def line(name, start, end):
    points = [[*start, 0.0], [*end, 0.0]]
    return MapElement(name, ElementClass.SLOT_LINE, points, width_m=WIDTH_M)


DIVIDERS = [line(f"d{k}", (k * STEP_M, 0.0), (k * STEP_M, DEPTH_M)) for k in range(5)]
BARS = [line(f"b{k}", (k * STEP_M - REACH_M, 0.06), (k * STEP_M + REACH_M, 0.06)) for k in range(3)]


def smeared(*spans, share=0.25, bare=0.01):
    """Looks at paint along the entrance between some places, too faint to follow; nothing else is painted."""

    def paint_at(xy):
        s_m, t_m = np.asarray(xy).T
        on = np.any([(s_m > low) & (s_m < high) for low, high in spans], axis=0) if spans else np.zeros(len(s_m), bool)
        hits = bare + share * on * np.exp(-0.5 * ((t_m - 0.5 * WIDTH_M) / 0.1) ** 2)
        return np.full(len(s_m), 10.0), 10.0 * hits

    return paint_at


def found(paint_at, lines=(*DIVIDERS, *BARS)):
    """Bars by name that the row has more than what was followed, and the rows."""
    drawn = draw_rows(lines, WAY)
    more = with_bars(drawn, paint_at)
    known = {element.id for element in drawn.lines}
    return {e.id: e.points[:, :2] for e in more.lines if e.id not in known}, more.rows


def test_a_bar_that_a_quarter_of_the_looks_show_is_as_long_as_the_others():
    at = 3 * STEP_M
    bars, (row,) = found(smeared((at - REACH_M, at + REACH_M)))
    assert sorted(bars) == ["d3_bar_3_left", "d3_bar_3_right"]
    np.testing.assert_allclose(bars["d3_bar_3_left"], [[at + 0.06, 0.06], [at + REACH_M, 0.06]], atol=5e-3)
    np.testing.assert_allclose(bars["d3_bar_3_right"], [[at - 0.06, 0.06], [at - REACH_M, 0.06]], atol=5e-3)
    assert row.places[3].ids == ("d3", "d3_bar_3_right", "d3_bar_3_left")
    assert all("bar" not in " ".join(place.ids) for k, place in enumerate(row.places) if k != 3)


def test_bare_road_and_smear_everywhere_show_no_bar():
    at = 3 * STEP_M
    assert found(smeared())[0] == {}
    assert found(smeared((at - REACH_M, at + REACH_M), share=0.08))[0] == {}
    assert found(smeared((at - REACH_M, at + REACH_M), bare=0.2))[0] == {}


def test_paint_of_another_length_is_no_bar():
    """A line that goes on past where bars end, and a spot beside a divider."""
    at = 3 * STEP_M
    assert found(smeared((at, at + 1.7)))[0] == {}
    assert found(smeared((at, at + 0.3)))[0] == {}


def test_two_bars_tell_no_length_and_no_looks_change_nothing():
    at = 3 * STEP_M
    assert found(smeared((at - REACH_M, at + REACH_M)), (*DIVIDERS, BARS[0]))[0] == {}
    assert found(None)[0] == {}


def test_bars_beside_places_that_one_line_shows_have_names_of_their_own():
    """A bar from one unseen divider to the next shows both; on the other side of each a bar is due."""
    between = line("between", (3 * STEP_M + 0.06, 0.06), (4 * STEP_M - 0.06, 0.06))
    dividers = [*DIVIDERS[:3], line("d5", (5 * STEP_M, 0.0), (5 * STEP_M, DEPTH_M))]
    spans = [(k * STEP_M - REACH_M, k * STEP_M + REACH_M) for k in (3, 4)]
    drawn = with_bars(draw_rows((*dividers, *BARS, between), WAY), smeared(*spans))
    names = [element.id for element in drawn.lines]
    assert len(names) == len(set(names))
