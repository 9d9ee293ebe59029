"""Halves of a map that agree, and halves that do not."""

import numpy as np
import pytest

from semloc_jax.alignment.agreement import NUM_KINDS, AgreementConfig, disagreement, halves, kinds, kinds_apart
from semloc_jax.alignment.candidates import planar
from semloc_jax.structs import ElementClass


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


def test_every_kind_is_compared_with_all_else():
    label = np.array([ElementClass.LANE_MARKING, ElementClass.POLE, ElementClass.STOP_LINE, -1])
    assert kinds(label).tolist() == [
        [True, False, False, False],
        [False, True, True, False],
        [False, True, False, False],
        [True, False, True, False],
    ]


def test_kinds_that_agree_differ_as_their_covariances_say():
    """Squared distances of independent estimates of one place have the mean of three degrees of freedom."""
    random = np.random.default_rng(0)
    sigma = np.array([[0.3, 0.05, 0.01], [0.1, 0.2, 0.02], [9.0, 9.0, 1.0], [0.1, 0.05, 0.01]])
    covariance = sigma[:, :, None] ** 2 * np.eye(3)
    found = []
    for _ in range(300):
        x, y, turn = (random.normal(size=(NUM_KINDS, 3)) * sigma).T
        Ts = planar(np.full(1, 4.0), np.full(1, -2.0), 0.7) @ planar(x, y, turn)
        Ts[2:] = Ts[3]  # what stands and all else are at one place: lane lines decide
        found.append(kinds_apart(Ts, covariance).kinds_chi2)
    assert np.mean(found) == pytest.approx(3.0, rel=0.15)


def test_lines_painted_anew_are_told_with_their_distance():
    Ts = np.tile(np.eye(4), (NUM_KINDS, 1, 1))
    Ts[0] = planar(np.array([0.1]), np.array([0.5]), 0.0)[0]
    apart = kinds_apart(Ts, np.tile(np.diag([0.2, 0.05, 0.01]) ** 2, (NUM_KINDS, 1, 1)))
    assert (apart.kinds_ahead_m, apart.kinds_left_m) == pytest.approx((0.1, 0.5))
    assert apart.kinds_chi2 == pytest.approx((0.1**2 / 0.2**2 + 0.5**2 / 0.05**2) / 2)
    assert kinds_apart(Ts * np.nan, np.ones((NUM_KINDS, 3, 3))).kinds_chi2 == 0.0
