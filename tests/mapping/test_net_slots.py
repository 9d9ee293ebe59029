"""Marking points become dividers: directions by their rows, short ones along the aisle."""

import numpy as np
import pytest

from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.mapping.net_slots import dividers_of
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
