"""Periods of a map are found where they were painted."""

import numpy as np
import pytest

from semloc_jax.alignment.aliases import AliasConfig, alias_shifts, road_direction
from semloc_jax.alignment.candidates import planar


def road(period_m, heading_rad, length_m=160.0, lane_m=3.75):
    """Samples of dashed and solid lines along a straight road through the origin: points, tangents, channel, length."""
    along = np.arange(-0.5 * length_m, 0.5 * length_m, 0.25)
    dashed = along[np.mod(along, period_m) < period_m / 3.0]
    rows = [np.column_stack([dashed, np.full(len(dashed), side)]) for side in (-0.5 * lane_m, 0.5 * lane_m)]
    rows += [np.column_stack([along, np.full(len(along), side)]) for side in (-1.5 * lane_m, 1.5 * lane_m)]
    points = np.vstack(rows)
    turn = np.array([[np.cos(heading_rad), -np.sin(heading_rad)], [np.sin(heading_rad), np.cos(heading_rad)]])
    tangents = np.tile(turn[:, 0], (len(points), 1))
    return points @ turn.T, tangents, np.zeros(len(points), int), np.full(len(points), 0.25)


@pytest.mark.parametrize("heading_deg", [0.0, 37.0])
@pytest.mark.parametrize("period_m", [18.0, 9.0])
def test_dashes_come_back_after_their_period(period_m, heading_deg):
    heading = np.deg2rad(heading_deg)
    T = planar(np.zeros(1), np.zeros(1), np.array([heading]))[0]
    shifts = alias_shifts(*road(period_m, heading), T, AliasConfig(along_m=20.0))
    along = shifts[np.abs(shifts[:, 1]) < 0.3, 0]
    for side in (-1.0, 1.0):
        assert np.abs(along - side * period_m).min() < 0.3


def test_samples_of_a_solid_line_are_no_period():
    """Samples 0.75 m apart fall on one another after every 0.75 m, which says nothing of the road."""
    points, tangents, channel, _ = road(6.0, 0.0)
    few = slice(None, None, 3)
    length_m = np.full(len(points[few]), 0.75)
    shifts = alias_shifts(points[few], tangents[few], channel[few], length_m, np.eye(4), AliasConfig(along_m=20.0))
    along = shifts[np.abs(shifts[:, 1]) < 0.3, 0]
    np.testing.assert_allclose(np.mod(along + 1.0, 6.0), 1.0, atol=0.6)
    assert len(along) >= 4


def test_shifts_are_those_of_the_vehicle_not_of_the_road():
    """A vehicle turned by 30 deg against the road finds the period where the road runs."""
    turn = np.deg2rad(30.0)
    T = planar(np.zeros(1), np.zeros(1), np.array([turn]))[0]
    shifts = alias_shifts(*road(18.0, 0.0), T, AliasConfig(along_m=20.0))
    expected = 18.0 * np.array([np.cos(turn), -np.sin(turn)])
    assert np.linalg.norm(shifts - expected, axis=1).min() < 0.3


def test_lanes_are_proposed_from_the_lines():
    T = np.eye(4)
    shifts = alias_shifts(*road(18.0, 0.0), T, AliasConfig(along_m=20.0))
    across = shifts[np.abs(shifts[:, 0]) < 0.3, 1]
    assert np.abs(across - 3.75).min() < 0.3 and np.abs(across + 3.75).min() < 0.3


def hall(slot_m, num=21):
    """Samples of a hall: slot lines on both sides of an aisle, 0.12 m wide, and after every third slot the upright
    edges of a pillar, all samples of which have one place."""
    at = slot_m * (np.arange(num) - num // 2)
    deep = np.arange(3.0, 8.0, 0.25)
    points, tangents, channel = [], [], []
    for side in (-1.0, 1.0):
        for edge in (-0.06, 0.06):
            x, y = np.meshgrid(at + edge, side * deep)
            points.append(np.column_stack([x.ravel(), y.ravel()]))
            tangents.append(np.tile([0.0, 1.0], (x.size, 1)))
            channel.append(np.zeros(x.size, int))
        for centre in at[::3]:
            for corner in ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)):
                points.append(np.tile([centre, side * 3.0] + np.array(corner), (8, 1)))
                tangents.append(np.tile([0.0, 0.0], (8, 1)))
                channel.append(np.ones(8, int))
    return np.vstack(points), np.vstack(tangents), np.concatenate(channel), np.full(sum(map(len, channel)), 0.25)


@pytest.mark.parametrize("slot_m", [2.4, 2.5, 2.58, 2.63])
def test_the_slot_aside_is_proposed_beside_the_bay_of_pillars(slot_m):
    """Lines are thinner than a cell, a slot is no whole number of cells, and the bays are the stronger periods."""
    shifts = alias_shifts(*hall(slot_m), np.eye(4), AliasConfig(along_m=20.0, num_along=2, num_across=2))
    for side in (-1.0, 1.0):
        assert np.linalg.norm(shifts - [side * slot_m, 0.0], axis=1).min() < 0.3


def test_no_map_has_no_aliases():
    empty = np.zeros((0, 2))
    assert alias_shifts(empty, empty, np.zeros(0, int), np.zeros(0), np.eye(4), AliasConfig()).shape == (0, 2)


def test_the_road_runs_to_the_side_that_the_vehicle_looks_to():
    tangents = np.array([[1.0, 0.0], [-1.0, 0.0], [0.99, 0.1]])
    assert road_direction(tangents, np.ones(3), np.array([-1.0, 0.0]))[0] < -0.99
