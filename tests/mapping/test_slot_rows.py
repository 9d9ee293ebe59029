"""Lines by slots are drawn as rows: what is hidden or worn at one divider is told by the others."""

import numpy as np
import pytest

from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.mapping.row_lines import back_in_paint, crossings, ends_in_paint, evened
from semloc_jax.mapping.slot_rows import MappedRow, RowConfig, _back, draw_rows
from semloc_jax.mapping.slots import SlotConfig, find_slots, split_double
from semloc_jax.maps import Belief, MapElement
from semloc_jax.structs import ElementClass

WAY = np.stack([np.linspace(-20.0, 40.0, 121), np.full(121, -3.0)], axis=1)
STEP_M, DEPTH_M, WIDTH_M = 2.5, 5.2, 0.12
RNG = np.random.default_rng(3)


def line(name, start, end, ends=(True, True)):
    points = [[*start, 0.0], [*end, 0.0]]
    return MapElement(name, ElementClass.SLOT_LINE, points, width_m=WIDTH_M, true_ends=ends)


def divider(k, near=0.0, far=DEPTH_M, ends=(True, True), off=0.0, name=None):
    return line(name or f"d{k}", (k * STEP_M + off, near), (k * STEP_M + off, far), ends)


def bar(k, left=0.7, right=0.7):
    return line(f"b{k}", (k * STEP_M - left, 0.06), (k * STEP_M + right, 0.06))


def by_id(lines):
    return {element.id: element.points[:, :2] for element in lines}


def test_a_mouth_behind_a_pillar_is_where_the_others_open():
    """The third divider is seen from 0.9 m on; its bar is cut where the divider passes through all the same."""
    lines = [divider(0), divider(1), divider(2, near=0.9, ends=(False, True)), divider(3), *(bar(k) for k in range(4))]
    drawn = draw_rows(lines, WAY)
    found = by_id(drawn.lines)
    np.testing.assert_allclose(found["d2"], [[5.0, 0.0], [5.0, DEPTH_M]], atol=2e-3)
    np.testing.assert_allclose(found["b2"][:, 0], [4.3, 4.94], atol=2e-3)
    np.testing.assert_allclose(found["b2_1"][:, 0], [5.06, 5.7], atol=2e-3)
    assert len(drawn.rows) == 1
    assert len(drawn.rows[0].places) == 4


def test_pieces_of_a_divider_are_one_line():
    pieces = [divider(1, 0.0, 2.5, (True, False)), divider(1, 3.1, DEPTH_M, (False, True), off=0.05, name="d1 far")]
    drawn = draw_rows([divider(0), *pieces, divider(2), divider(3)], WAY)
    found = by_id(drawn.lines)
    assert sorted(found) == ["d0", "d1", "d2", "d3"]
    np.testing.assert_allclose(found["d1"][:, 0], 2.5, atol=0.015)
    np.testing.assert_allclose(found["d1"][:, 1], [0.0, DEPTH_M], atol=2e-3)


def test_bars_show_a_divider_that_nobody_saw():
    """Its slots are there, on the word of the bars; a divider of paint is not."""
    lines = [divider(0), divider(1), divider(3), divider(4), *(bar(k) for k in range(5))]
    drawn = draw_rows(lines, WAY)
    assert "d2" not in by_id(drawn.lines)
    (row,) = drawn.rows
    places = row.dividers({element.id for element in drawn.lines})
    assert len(places) == 5
    np.testing.assert_allclose(places[2].mouth, [5.0, 0.0], atol=5e-3)
    beliefs = {element.id: Belief(0.02, 0.05, 3.0, 9, 1) for element in drawn.lines}
    slots = find_slots(drawn.lines, beliefs, WAY, EvidenceGrid(0.1), None, places)
    assert len(slots) == 4
    for element, _ in slots:
        np.testing.assert_allclose(element.points[2:, 1], DEPTH_M, atol=5e-3)
    # Without the bars it is a gap two slots wide, which holds none.
    alone = draw_rows([divider(0), divider(1), divider(3), divider(4)], WAY)
    assert [len(row.places) for row in alone.rows] == [2, 2]


def test_noise_of_single_lines_is_averaged_over_the_row():
    """Twenty dividers off by 4 cm across and 6 cm at their mouths: 1.6 and 1.5 cm are left."""
    off, ends = RNG.normal(0.0, 0.04, 20), RNG.normal(0.0, 0.06, 20)
    lines = [divider(k, near=float(ends[k]), off=float(off[k])) for k in range(20)]
    (row,) = draw_rows(lines, WAY).rows
    mouths = np.array([row.at(place.s_m) for place in row.places])
    error = mouths - np.stack([STEP_M * np.arange(20), np.zeros(20)], axis=1)
    assert np.sqrt(np.mean(error[:, 0] ** 2)) < 0.02
    assert np.sqrt(np.mean(error[:, 1] ** 2)) < 0.02


def test_dividers_that_are_not_painted_in_even_steps_stay_where_they_were_seen():
    s_m = np.array([0.0, 2.4, 5.2, 7.4, 10.3, 12.6])
    np.testing.assert_array_equal(evened(s_m, np.ones(6), 0.02), s_m)
    nearly = 2.5 * np.arange(6) + np.array([0.0, 0.03, -0.03, 0.03, -0.03, 0.0])
    assert np.abs(evened(nearly, np.ones(6), 0.02) - 2.5 * np.arange(6)).max() < 0.015


def test_the_back_is_one_line_that_bounds_the_slots():
    """Dividers were seen to end 20 cm too far; pieces of the line along the back say where they do."""
    pieces = [line("p0", (0.3, 5.2), (2.2, 5.2), (False, False)), line("p1", (5.4, 5.2), (7.1, 5.2), (False, False))]
    drawn = draw_rows([*(divider(k, far=5.4) for k in range(4)), *pieces], WAY)
    found = by_id(drawn.lines)
    np.testing.assert_allclose(found["d1"][1], [2.5, 5.2], atol=2e-3)
    assert "p1" not in found
    np.testing.assert_allclose(found["p0"], [[-0.06, 5.2], [7.56, 5.2]], atol=2e-3)


def test_the_back_is_found_in_looks_too_faint_for_a_line():
    """A line of 12 cm that one look in seven shows, smeared over half a metre."""
    y, x = np.mgrid[0.0125:7.0:0.025, 0.0125:7.5:0.025]
    rate = 0.15 * np.exp(-0.5 * ((y - 5.2) / 0.12) ** 2) + 0.01
    grid = EvidenceGrid(0.025)
    for _ in range(10):
        shows = RNG.random(y.shape) < rate
        xy = np.stack([x.ravel(), y.ravel()], axis=1)
        grid.add(xy, np.ones(len(xy)), shows.ravel().astype(int) - 1, np.ones(len(xy), bool))
    row = MappedRow(np.zeros(2), np.array([1.0, 0.0]), np.array([0.0, 1.0]), WIDTH_M)
    places = np.array([0.0, 2.5, 5.0, 7.5])
    assert back_in_paint(row, places, (4.8, 6.0), lambda xy: grid.sums(xy, 0)) == pytest.approx(5.2, abs=0.02)
    assert back_in_paint(row, places, (2.0, 4.0), lambda xy: grid.sums(xy, 0)) is None


def test_dividers_without_a_line_along_the_back_tell_its_depth_together():
    """Half of the looks at paint show it, smeared over 0.3 m; where a vehicle hides what is behind, nothing ends."""
    y, x = np.mgrid[0.0125:7.5:0.025, -0.5:8.0:0.025]
    away = np.abs(x - STEP_M * np.round(x / STEP_M))
    rate = 0.5 * (away < 0.06) / (1.0 + np.exp((y - 5.2) / 0.08)) + 0.01
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    row = MappedRow(np.zeros(2), np.array([1.0, 0.0]), np.array([0.0, 1.0]), WIDTH_M)
    places = np.array([0.0, 2.5, 5.0, 7.5])
    for is_open, depth_m in ((np.ones(len(xy), bool), 5.2), (xy[:, 1] < 4.6, None)):
        grid = EvidenceGrid(0.025)
        for _ in range(10):
            shows = RNG.random(y.shape) < rate
            grid.add(xy, np.ones(len(xy)), shows.ravel().astype(int) - 1, is_open)
        found = ends_in_paint(row, places, (4.0, 6.5), lambda xy, grid=grid: grid.sums(xy, 0))
        assert found == (None if depth_m is None else pytest.approx(depth_m, abs=0.03))


def test_gaps_in_worn_dividers_are_no_back_of_a_shallow_row():
    """Three of five dividers end at a gap 2.4 m in: no depth that slots one drives into have."""
    lines = [divider(k, far=2.4) for k in range(3)] + [divider(k, far=4.5, ends=(True, False)) for k in (3, 4)]
    assert draw_rows(lines, WAY).rows[0].depth_m is None
    lines = [divider(0, far=4.9)] + [divider(k, far=5.15, ends=(True, False)) for k in (1, 2)]
    assert draw_rows(lines, WAY).rows[0].depth_m is None, "two go on beyond where one was seen to end"


def test_a_row_of_which_little_was_seen_runs_as_its_long_neighbour():
    """Three mouths that scatter by 10 cm would turn their row by 2 deg."""
    lines = [divider(k) for k in range(9)]
    mouths = [(30.0, 0.1), (32.5, -0.1), (35.0, -0.1)]
    lines += [line(f"e{k}", (x, y), (x, DEPTH_M)) for k, (x, y) in enumerate(mouths)]
    rows = draw_rows(lines, WAY + [5.0, 0.0]).rows
    assert [len(row.places) for row in rows] == [9, 3]
    np.testing.assert_allclose(rows[1].along, [1.0, 0.0], atol=np.deg2rad(0.1))


def test_a_line_through_two_rows_is_a_divider_of_each():
    long = line("long", (2 * STEP_M, 0.0), (2 * STEP_M, 2 * DEPTH_M))
    lone = line("lone", (30.0, 0.0), (30.0, 2 * DEPTH_M))
    way = np.vstack([WAY, WAY + [0.0, 2 * DEPTH_M + 6.0]])
    lines = [divider(0), divider(1), long, lone]
    dividers = draw_rows([divider(0), divider(1)], way).rows[0].dividers({"d0", "d1"})
    found = by_id(split_double(lines, dividers, SlotConfig()))
    assert sorted(found) == ["d0", "d1", "lone", "long", "long_back"]
    np.testing.assert_allclose(found["long"], [[5.0, 0.0], [5.0, DEPTH_M]])
    np.testing.assert_allclose(found["long_back"], [[5.0, DEPTH_M], [5.0, 2 * DEPTH_M]])


def test_the_order_of_the_lines_changes_nothing():
    lines = [*(divider(k, off=0.01 * k % 0.03) for k in range(5)), *(bar(k) for k in range(5))]
    one, other = (by_id(draw_rows(some, WAY).lines) for some in (lines, lines[::-1]))
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_allclose(one[name], other[name], atol=1e-6)


def test_a_row_whose_line_lies_beside_its_dividers_has_no_back():
    """Drawn anew, a row may find no divider on its line at all: it is no row, and the lines stay."""
    row = MappedRow(np.zeros(2), np.array([1.0, 0.0]), np.array([0.0, 1.0]), WIDTH_M, depth_m=DEPTH_M)
    found = _back(row, np.zeros(0), [line("back", (0.0, DEPTH_M), (8.0, DEPTH_M))], RowConfig())
    assert (found.lines, found.used) == ([], set())


def test_two_mouths_of_one_divider_tell_no_step():
    assert crossings([np.array([1.0, 3.0])], [0.5, 0.5], WIDTH_M) == []
