"""Slots come out of the lines between them: corners, type, depth and occupancy."""

import numpy as np
import pytest

from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.mapping.slots import SlotConfig, find_slots, split_crossbars
from semloc_jax.maps import Belief, MapElement
from semloc_jax.structs import ElementClass

WAY = np.stack([np.linspace(-20.0, 40.0, 121), np.full(121, -3.0)], axis=1)


def line(name, start, end, ends=(True, True), width=0.12):
    points = [[*start, 0.0], [*end, 0.0]]
    return MapElement(name, ElementClass.SLOT_LINE, points, width_m=width, true_ends=ends)


def row(count, step, depth, lean=0.0, y=0.0, up=1.0, ends=(True, True)):
    """Dividers every `step` metres from y, leaning by `lean` metres over their depth."""
    return [
        line(f"d{y:g}_{k}", (k * step, y), (k * step + lean, y + up * depth), (ends[0], ends[1])) for k in range(count)
    ]


def slots_of(lines, vehicles=None, config=None, way=WAY):
    beliefs = {e.id: Belief(0.02 + 0.01 * k, 0.05, 3.0 - k, 9 - k, k) for k, e in enumerate(lines)}
    return find_slots(lines, beliefs, way, vehicles or EvidenceGrid(0.1), config)


@pytest.mark.parametrize(
    ("lines", "kind", "depth"),
    [
        (row(4, 2.5, 5.2), "perpendicular", 5.2),
        (row(3, 6.1, 2.35), "parallel", 2.35),
        (row(4, 2.9, 4.5, lean=2.6), "angled", np.hypot(4.5, 2.6)),
    ],
)
def test_neighbours_hold_a_slot(lines, kind, depth):
    found = slots_of(lines)
    assert len(found) == len(lines) - 1
    for element, belief in found:
        assert element.label == ElementClass.PARKING_SLOT
        assert element.attributes["kind"] == kind
        # The entrance first, at the aisle, and the slot to its left.
        np.testing.assert_allclose(element.points[:2, 1], 0.0, atol=1e-9)
        edge, inward = element.points[1] - element.points[0], element.points[2] - element.points[1]
        assert edge[0] * inward[1] - edge[1] * inward[0] > 0.0
        assert np.linalg.norm(inward) == pytest.approx(depth, abs=1e-6)
        assert belief.num_seen <= 9


def test_a_line_along_the_back_bounds_the_slot_with_its_middle():
    back = line("back", (-1.0, 5.2), (9.0, 5.2))
    for element, _ in slots_of([*row(3, 2.5, 5.26), back]):
        np.testing.assert_allclose(element.points[2:, 1], 5.2, atol=1e-9)


def test_a_divider_that_ends_at_a_gap_in_the_paint_tells_no_depth():
    lines = [*row(2, 2.5, 5.2), line("worn", (5.0, 0.0), (5.0, 1.9)), line("worn too", (7.5, 0.0), (7.5, 2.0))]
    depths = [float(np.linalg.norm(e.points[2] - e.points[1])) for e, _ in slots_of(lines)]
    assert depths == pytest.approx([5.2] * 2, abs=1e-6)
    assert slots_of(lines[2:]) == []


def test_one_whole_divider_tells_that_a_slot_lies_along_the_aisle():
    """A pillar or a line along the back hides where the other one ends; where both ends are hidden nothing is told."""
    whole, hidden = row(3, 6.1, 2.35), row(3, 6.1, 2.35, ends=(True, False))
    for lines in ([whole[0], hidden[1], whole[2]], [hidden[0], whole[1], hidden[2]]):
        assert [element.attributes["kind"] for element, _ in slots_of(lines)] == ["parallel"] * 2
    assert slots_of(hidden) == []
    assert slots_of([whole[0], row(2, 6.1, 5.2)[1]]) == []
    # Dividers that one drives between, of which worn paint ends one early and a car hides the end of the other.
    (worn, _), (_, other) = row(2, 2.5, 2.35), row(2, 2.5, 2.35, ends=(True, False))
    config = SlotConfig(assumed_depth_m=(5.0, 2.2))
    assert [element.attributes["kind"] for element, _ in slots_of([worn, other], config=config)] == ["perpendicular"]


def test_the_weaker_line_says_how_sure_a_slot_is():
    (_, belief), *_ = slots_of(row(2, 2.5, 5.2))
    assert (belief.sigma_across_m, belief.existence_logit, belief.num_seen, belief.num_missed) == (0.03, 2.0, 8, 1)


def test_a_missing_divider_makes_no_wide_slot():
    lines = row(5, 2.5, 5.2)
    assert len(slots_of([*lines[:2], *lines[3:]])) == 2


def test_a_slot_whose_back_nobody_saw_takes_half_of_the_way_to_the_row_behind():
    front = row(3, 2.5, 4.0, ends=(True, False))
    back = row(3, 2.5, 4.0, y=10.4, up=-1.0, ends=(True, False))
    way = np.vstack([WAY, WAY + [0.0, 16.4]])
    found = slots_of([*front, *back], way=way)
    assert len(found) == 4
    for element, _ in found:
        assert np.linalg.norm(element.points[2] - element.points[1]) == pytest.approx(5.2, abs=1e-6)
    assert slots_of(front) == []


def test_slots_along_the_aisle_do_not_meet_those_behind_them():
    way = np.vstack([WAY, WAY + [0.0, 16.4]])
    found = slots_of([*row(3, 6.1, 2.35), *row(3, 6.1, 2.35, y=10.4, up=-1.0)], way=way)
    assert [e.attributes["kind"] for e, _ in found] == ["parallel"] * 4
    for element, _ in found:
        assert np.linalg.norm(element.points[2] - element.points[1]) == pytest.approx(2.35, abs=1e-6)


def test_slots_of_a_type_are_as_deep_as_most_but_for_those_that_are_clearly_not():
    far = [line(f"far_{k}", (20 + 2.5 * k, 0.0), (20 + 2.5 * k, 4.6)) for k in range(2)]
    deep = [line(f"deep_{k}", (40 + 2.5 * k, 0.0), (40 + 2.5 * k, 5.4)) for k in range(2)]  # ends told 0.2 m off
    lines = [*row(4, 2.5, 5.2), line("short", (10.0, 0.0), (10.0, 5.12)), *far, *deep]
    depths = {round(float(e.points[0, 0]), 1): np.linalg.norm(e.points[2] - e.points[1]) for e, _ in slots_of(lines)}
    assert depths == pytest.approx({0.0: 5.2, 2.5: 5.2, 5.0: 5.2, 7.5: 5.2, 20.0: 4.6, 40.0: 5.2}, abs=1e-6)


def test_lines_at_other_distances_and_angles_hold_nothing():
    assert slots_of(row(2, 1.5, 5.2)) == []
    assert slots_of(row(2, 3.6, 5.2)) == []
    assert slots_of([line("a", (0, 0), (0, 5.2)), line("b", (2.5, 0), (3.3, 5.2))]) == []


def test_a_vehicle_in_the_front_half_takes_the_slot():
    vehicles = EvidenceGrid(0.1)
    xy = np.stack(np.meshgrid(np.arange(0.05, 5.0, 0.1), np.arange(0.05, 3.0, 0.1)), axis=-1).reshape(-1, 2)
    is_vehicle = xy[:, 0] > 2.5
    vehicles.add(xy, np.ones(len(xy)), is_vehicle.astype(int) - 1, np.ones(len(xy), bool))
    found = {e.points[0, 0]: e.attributes.get("occupied") for e, _ in slots_of(row(4, 2.5, 5.2), vehicles)}
    assert found == {0.0: False, 2.5: True, 5.0: None}


def test_a_bar_across_the_mouth_is_two():
    """The bar is cut where the divider passes through; a long line is not."""
    divider, bar = line("div", (0, 0), (0, 5.2)), line("bar", (-0.7, 0.06), (0.7, 0.06))
    back = line("back", (-6, 5.2), (6, 5.2))
    found = {e.id: e.points[:, 0].tolist() for e in split_crossbars([divider, bar, back], SlotConfig())}
    assert found["div"] == [0.0, 0.0]
    assert found["back"] == [-6.0, 6.0]
    np.testing.assert_allclose(found["bar"], [-0.7, -0.06], atol=1e-9)
    np.testing.assert_allclose(found["bar_1"], [0.06, 0.7], atol=1e-9)
