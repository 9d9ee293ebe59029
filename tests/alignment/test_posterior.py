"""The posterior over places, against sums written out by hand."""

import numpy as np
import pytest

from semloc_jax.alignment.candidates import planar
from semloc_jax.alignment.posterior import PosteriorConfig, log_prior, ridges, spread, temper

CONFIG = PosteriorConfig(least_temper=1.0)


def poses(*moves):
    x_m, y_m, heading_deg = np.array(moves, dtype=float).T
    return planar(x_m, y_m, np.deg2rad(heading_deg))


def in_blocks(nats, blocks=12):
    """Nats spread evenly over the image: nothing in their scatter speaks against them."""
    return np.repeat(np.asarray(nats, dtype=float)[:, None] / blocks, blocks, axis=1)


def test_probabilities_are_the_brute_force_posterior_where_evidence_is_believed():
    Ts = poses((0, 0, 0), (18, 0, 0), (0, 3.5, 0), (-18, 0, 0))
    nats, prior = np.array([50.0, 49.0, 47.0, 50.5]), np.array([-0.2, -1.0, -0.5, -2.5])
    found = ridges(Ts, in_blocks(nats), prior, CONFIG)
    weight = np.exp(nats + prior - (nats + prior).max())
    expected = weight / weight.sum()
    assert found.probability == pytest.approx(np.sort(expected)[::-1], abs=1e-9)
    assert list(found.best) == list(np.argsort(-expected))
    best, second = np.sort(expected)[:-3:-1]
    assert found.margin_nats == pytest.approx(np.log(best / second))
    assert ridges(Ts[:1], in_blocks(nats[:1]), prior[:1], CONFIG).margin_nats == np.inf


def test_neighbours_are_one_place_with_the_weight_of_the_best():
    Ts = poses((0, 0, 0), (1.5, 0.1, 0.3), (18, 0, 0))
    found = ridges(Ts, in_blocks([50.0, 49.9, 48.0]), np.zeros(3), CONFIG)
    assert list(found.home) == [0, 0, 1]
    assert found.probability[0] == pytest.approx(1.0 / (1.0 + np.exp(-2.0)))


def test_a_turn_about_what_is_in_view_is_the_same_place():
    turn_deg = 1.5
    aside_m = -CONFIG.lever_m * np.deg2rad(turn_deg)
    Ts = poses((0, 0, 0), (0, aside_m, turn_deg), (0, aside_m, -turn_deg))
    assert list(ridges(Ts, in_blocks([9.0, 8.0, 7.0]), np.zeros(3), CONFIG).home) == [0, 0, 1]


def test_evidence_that_scatters_over_the_image_is_believed_less():
    random = np.random.default_rng(0)
    steady, ragged = np.full(24, 0.5), random.normal(0.5, 6.0, 24)
    ragged += 0.5 - ragged.mean()
    # The best candidate has both differences to the others, of the same sum.
    blocks = np.stack([np.full(24, 2.0), 2.0 - steady, 2.0 - ragged])
    given = temper(blocks, 0, PosteriorConfig())
    assert given[1] == 1.0
    variance = ragged.var(ddof=1)
    assert given[2] == pytest.approx(max(2.0 * 12.0 / (24 * variance), 0.1))


def test_a_prior_stated_too_small_does_not_decide_alone():
    """Twenty sigmas away a normal prior would cost 200 nats; Student's t leaves the choice to the masks."""
    far = log_prior(poses((0, 2.0, 0)), np.eye(4), 0.1, 0.05)[0]
    assert -20.0 < far < -10.0
    near = log_prior(poses((0, 0.1, 0)), np.eye(4), 0.1, 0.05)[0]
    assert near == pytest.approx(-3.0 * np.log1p(1.0 / 3.0))


def test_the_prior_wraps_headings():
    T = planar(np.zeros(1), np.zeros(1), np.array([np.pi - 0.01]))
    other = planar(np.zeros(1), np.zeros(1), np.array([-np.pi + 0.01]))
    assert log_prior(other, T[0], 1.0, 0.1)[0] == pytest.approx(-3.0 * np.log1p(0.04 / 3.0), abs=1e-9)


def test_what_saw_nothing_is_no_place():
    Ts = poses((0, 0, 0), (18, 0, 0))
    found = ridges(Ts, np.array([[np.nan] * 4, [1.0] * 4]), np.zeros(2), CONFIG)
    assert list(found.best) == [1] and list(found.home) == [-1, 0]
    nothing = ridges(Ts, np.full((2, 4), np.nan), np.zeros(2), CONFIG)
    assert len(nothing.best) == 0 and len(nothing.probability) == 0


def test_spread_is_the_weighted_second_moment():
    Ts = poses((0, 0, 0), (0.4, 0, 0), (0, 0.2, 1.0))
    found = spread(Ts[0], Ts, np.log([0.5, 0.3, 0.2]))
    assert found[0, 0] == pytest.approx(0.3 * 0.4**2)
    assert found[1, 1] == pytest.approx(0.2 * 0.2**2)
    assert found[2, 2] == pytest.approx(0.2 * np.deg2rad(1.0) ** 2)
