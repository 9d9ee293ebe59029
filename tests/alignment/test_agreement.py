"""Halves of a map that agree, and halves that do not."""

import numpy as np
import pytest

from semloc_jax.alignment.agreement import AgreementConfig, disagreement, halves
from semloc_jax.alignment.candidates import planar


def test_both_halves_of_a_split_have_every_sample_once_and_elements_whole():
    element = np.repeat(np.arange(40), 5)
    parts = halves(element, AgreementConfig(num_splits=3))
    assert parts.shape == (7, 200) and parts[0].all()
    assert np.array_equal(parts[1:4], ~parts[4:])
    for part in parts[1:]:
        assert 0.2 < part.mean() < 0.8
        by_element = part.reshape(40, 5)
        assert (by_element.all(axis=1) | ~by_element.any(axis=1)).all()


def test_no_element_at_all_is_no_error():
    assert halves(np.full(4, -1), AgreementConfig(num_splits=2)).shape == (5, 4)


def test_the_spread_of_halves_is_that_of_the_mean_of_observations():
    """Elements that each know a place with an error of 1 m: halves scatter about the mean as the mean does about the
    truth."""
    random, config = np.random.default_rng(0), AgreementConfig(num_splits=200)
    found_m2, true_m2 = [], []
    for _ in range(40):
        places = random.normal(size=64)
        parts = halves(np.arange(64), config)[1:]
        means = np.array([places[part].mean() for part in parts])
        T = planar(np.array([3.0]), places[None].mean(axis=1), 0.4)[0]
        Ts = planar(np.full(len(means), 3.0), means, 0.4)
        found_m2.append(disagreement(T, Ts, np.full(3, 1.0 / 64.0))[:2].sum())
        true_m2.append(places.mean() ** 2)
    assert np.mean(found_m2) == pytest.approx(1.0 / 64.0, rel=0.2)
    assert np.mean(true_m2) == pytest.approx(np.mean(found_m2), rel=0.5)


def test_axes_are_those_of_the_vehicle():
    T = planar(np.array([0.0]), np.array([0.0]), np.pi / 2.0)[0]
    Ts = planar(np.zeros(2), np.array([0.3, -0.3]), np.array([np.pi / 2.0 + 0.01, np.pi / 2.0 - 0.01]))
    assert disagreement(T, Ts, np.ones(3)) == pytest.approx([0.09, 0.0, 1e-4], abs=1e-9)


def test_halves_that_scatter_more_than_promised_take_that_much_again():
    T, Ts = np.eye(4), planar(np.array([0.1, -0.1]), np.array([0.2, -0.2]), np.array([0.01, -0.01]))
    found = np.array([0.01, 0.04, 1e-4])
    assert disagreement(T, Ts, found / [1.0, 9.0, 4.0]) == pytest.approx(found * [4.0, 4.0, 1.0])
    # Only to the side: a lever of the heading, not a contradiction.
    assert disagreement(T, Ts, found / [1.0, 9.0, 0.5]) == pytest.approx(found)
