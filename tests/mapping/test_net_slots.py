"""Marking points become dividers: directions by their rows, short ones along the aisle."""

import numpy as np
import pytest

from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.mapping.point_dividers import by_their_rows, dividers_of, open_to
from semloc_jax.mapping.slots import ANGLED, PARALLEL, PERPENDICULAR, SlotConfig, find_slots
from semloc_jax.maps import Belief

CONFIG = SlotConfig(assumed_depth_m=(5.0, 2.2))
KINDS = {PERPENDICULAR: (2.5, 0.0), PARALLEL: (5.5, 0.0), ANGLED: (3.2, 40.0)}


def row(pitch_m, skew_deg, noise_deg, num=5):
    """Points 3 m to the left of the way, and directions as a network says them."""
    rng = np.random.default_rng(3)
    places = np.stack([pitch_m * np.arange(num), np.full(num, 3.0)], axis=1)
    turn = np.deg2rad(90.0 - skew_deg + noise_deg * rng.uniform(-1.0, 1.0, num))
    return places, np.stack([np.cos(turn), np.sin(turn)], axis=1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_row_of_points_is_a_row_of_slots(kind):
    """Directions that are 10 deg off do not bend a row; the slots have the type and the width of their pitch."""
    pitch_m, skew_deg = KINDS[kind]
    places, inward = row(pitch_m, skew_deg, noise_deg=10.0 if skew_deg == 0.0 else 2.0)
    dividers = dividers_of(places, inward, 0.0, CONFIG)
    beliefs = dict.fromkeys([d.id for d in dividers], Belief(0.1, 0.1, 0.0, num_seen=1))
    way = np.stack([np.linspace(-5.0, 25.0, 61), np.zeros(61)], axis=1)
    found = [element for element, _ in find_slots([], beliefs, way, EvidenceGrid(0.1), CONFIG, dividers)]
    assert [element.attributes["kind"] for element in found] == [kind] * (len(places) - 1)
    for element in found:
        step = element.points[1, :2] - element.points[0, :2]
        assert np.linalg.norm(step) == pytest.approx(pitch_m, abs=1e-6)
        inward_deg = np.rad2deg(np.arctan2(*(element.points[3] - element.points[0])[:2][::-1]))
        assert inward_deg == pytest.approx(90.0 - skew_deg, abs=1.0 if skew_deg else 1e-6)


def test_two_rows_across_an_aisle_are_two():
    places, inward = row(2.5, 0.0, 8.0)
    both = np.concatenate([places, places * [1.0, -1.0]])
    dividers = dividers_of(both, np.concatenate([inward, inward * [1.0, -1.0]]), 0.0, CONFIG)
    assert [np.sign(d.inward[1]) for d in dividers] == [1.0] * 5 + [-1.0] * 5


def kinds_of(places, inward):
    """Types of the slots between marking points beside a straight way."""
    dividers = dividers_of(places, inward, 0.0, CONFIG)
    beliefs = dict.fromkeys([d.id for d in dividers], Belief(0.1, 0.1, 0.0, num_seen=1))
    way = np.stack([np.linspace(-5.0, 25.0, 61), np.zeros(61)], axis=1)
    return [
        element.attributes["kind"] for element, _ in find_slots([], beliefs, way, EvidenceGrid(0.1), CONFIG, dividers)
    ]


@pytest.mark.parametrize(("num", "off_deg"), [(2, 45.0), (3, 45.0), (5, 45.0), (5, 90.0)])
def test_an_l_between_its_legs_is_mended_by_the_neighbour(num, off_deg):
    """At both ends of a row along the aisle the network says the entrance, or half way between it and the divider."""
    places, inward = row(5.5, 0.0, 0.0, num)
    across, into = np.sin(np.deg2rad(off_deg)), np.cos(np.deg2rad(off_deg))
    inward[0], inward[-1] = [across, into], [-across, into]
    mended = by_their_rows(places, inward, CONFIG)
    np.testing.assert_allclose(mended, np.tile([0.0, 1.0], (num, 1)), atol=1e-9)
    assert kinds_of(places, mended) == [PARALLEL] * (num - 1)


def test_rows_without_an_l_stay_as_the_network_says():
    for pitch_m, skew_deg in KINDS.values():
        places, inward = row(pitch_m, skew_deg, noise_deg=10.0)
        np.testing.assert_array_equal(by_their_rows(places, inward, CONFIG), inward)


def test_a_missed_point_makes_no_slot_along_the_aisle_of_two():
    places, inward = row(2.5, 0.0, 5.0)
    kept = [0, 2, 3, 4]
    assert kinds_of(places[kept], inward[kept]) == [PERPENDICULAR] * 2


def test_the_back_of_a_slot_does_not_open_to_the_way():
    """Back corners of slots along the aisle, 2.2 m behind their mouths, point to the aisle; mouths do not."""
    places, inward = row(5.5, 0.0, 10.0, num=2)
    way = np.stack([np.linspace(-7.0, 7.0, 57), np.zeros(57)], axis=1)
    both, turns = np.concatenate([places, places + [0.0, 2.2]]), np.concatenate([inward, -inward])
    assert open_to(way, both, turns).tolist() == [True, True, False, False]
    # The divider at the end of such a row looks like an entrance from the side.
    end = np.array([[0.0, 3.0], [0.0, 5.2]])
    assert not open_to(way, end, np.array([[1.0, 0.0], [1.0, 0.0]])).any()
    # Backing into a slot, the vehicle is between the mouths of both dividers.
    assert open_to(way + [0.0, 3.0], places, inward).all()
