"""The likelihood of poses by pieces of contour: what is missed is bounded, what leaves the view changes nothing."""

import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment import pieces
from semloc_jax.alignment.pieces import Chances, PieceCosts, _runs, against_first, believed, chances, nats_by_piece

LINES, POSTS = 0, 1
CHANNEL = jnp.asarray([LINES] * 8 + [POSTS] * 2)
MASKS = Chances(jnp.asarray([0.9, 0.2]), jnp.asarray([0.1, 0.05]))


def costs(*poses):
    """Nats of one observation of each piece for every pose; NaN: not in view."""
    nats = np.array(poses, np.float32)
    return PieceCosts(jnp.asarray(np.nan_to_num(nats)), jnp.asarray(np.isfinite(nats), jnp.float32))


def nats_of_poses(costs, channel, masks):
    """Cost [nats] of every pose: the sum over its pieces."""
    return np.asarray(nats_by_piece(costs, channel, masks), float).sum(axis=1)


def test_contour_is_cut_where_an_edge_ends_and_where_one_observation_is_full():
    edge = jnp.asarray([0, 0, 0, 0, 0, 1, 2, 2])
    weight = jnp.asarray([10.0, 10.0, 10.0, 10.0, 10.0, 4.0, 10.0, 10.0])
    assert np.asarray(_runs(edge, weight, jnp.asarray(20.0))).tolist() == [0, 0, 1, 1, 2, 3, 4, 4]


def test_a_piece_that_is_missed_costs_no_more_than_its_rate_says():
    """Oracle: the mixture P exp(-nats) / p0 + 1 - P, by hand."""
    matched, missed = [0.0] * 10, [40.0] + [0.0] * 9
    both = nats_of_poses(costs(matched, missed), CHANNEL, MASKS)
    assert both[1] - both[0] == pytest.approx(np.log(0.1 + 0.9 / 0.1) - np.log(0.1), rel=1e-4)
    worse = [400.0] + [0.0] * 9
    assert nats_of_poses(costs(worse), CHANNEL, MASKS)[0] == pytest.approx(both[1], rel=1e-4)


def test_a_post_that_the_masks_never_show_hardly_pulls_a_pose_away_from_itself():
    """Robust costs would give a pose 15 nats for turning its back on one post of 60 px."""
    in_view, out_of_view = [0.1] * 8 + [7.0, 7.0], [0.1] * 8 + [7.0, np.nan]
    both = nats_of_poses(costs(in_view, out_of_view), CHANNEL, MASKS)
    assert abs(both[0] - both[1]) < 0.25


def test_lines_that_leave_the_image_change_nothing_where_the_rest_fits():
    whole, part = [0.1] * 10, [np.nan] * 3 + [0.1] * 7
    both = nats_of_poses(costs(whole, part), CHANNEL, MASKS)
    assert both[0] == pytest.approx(both[1], abs=1e-3)


def test_rates_are_those_of_the_frame():
    """All lines fit at the good pose and one in ten at random ones; of the posts none fits anywhere."""
    good = PieceCosts(jnp.asarray([0.1] * 8 + [7.0] * 2), jnp.ones(10))
    random = costs(*np.where(np.eye(10) > 0, 0.0, 9.0))
    told = chances(good, random, CHANNEL, 2)
    assert told.by_chance[LINES] == pytest.approx(0.1, abs=0.01)
    assert 0.75 < told.detection[LINES] < 0.9 and told.detection[POSTS] < 0.5


def test_nats_that_few_pieces_decide_are_believed_less():
    """Ten nats of ten pieces, and of one: the formula of `posterior.temper`, by hand."""
    none, together, alone = np.zeros(10), np.full(10, 1.0), np.r_[10.0, np.zeros(9)]
    mixed = np.r_[np.full(5, 3.0), np.full(5, -2.0)]
    share = np.asarray(believed(jnp.asarray([none, together, alone, mixed], jnp.float32), jnp.asarray(0), 0.1))
    assert share[1] == 1.0
    # One piece counts as two of half: their variance is 2 x (5^2 + 0) / 1.
    assert share[2] == pytest.approx(2 * 10.0 / (2 * 25.0), rel=1e-4)
    assert share[3] == pytest.approx(2 * 5.0 / (10 * 10 * 6.25 / 9), rel=1e-4)


def test_what_only_one_pose_sees_is_not_held_against_it():
    """Bars slid under parked cars: three of those that fit are left, and none of the four that masks missed. That is
    worth nothing; a place where also the missed ones fit is worth what they say, and one where none fits costs it."""
    nan = np.nan
    here = [0.3] * 6 + [7.0] * 4
    slid, better, worse = [0.3] * 3 + [nan] * 7, [0.3] * 10, [7.0] * 10
    at_random = costs(*[[7.0] * 10] * 3, [0.3] * 10)
    channel = jnp.zeros(10, int)
    found = np.asarray(against_first(costs(here, slid, better, worse), at_random, channel, 1))
    assert found[0] == pytest.approx(0.0, abs=1e-5)
    assert found[1] < -4.0 and found[2] > 6.0


def test_sums_over_channels_are_the_same_for_many_poses_as_for_few(monkeypatch):
    """Many poses with many pieces are summed one channel after another."""
    rng = np.random.default_rng(3)
    costs = PieceCosts(*(jnp.asarray(rng.uniform(0.0, most, (9, 60)), jnp.float32) for most in (8.0, 1.0)))
    channel, masks = jnp.asarray(rng.integers(0, 4, 60)), Chances(jnp.full(4, 0.7), jnp.full(4, 0.1))
    few = nats_by_piece(costs, channel, masks)
    monkeypatch.setattr(pieces, "_MOST_AT_ONCE", 4 * 60)
    many = nats_by_piece(costs, channel, masks)
    np.testing.assert_allclose(many, few, rtol=1e-6)
    seen = np.where(np.asarray(channel) == 2, np.asarray(costs.observations), 0.0).sum(axis=1)
    np.testing.assert_allclose(pieces._by_channel(costs.observations, channel, 4)[:, 2], seen, rtol=1e-5)
