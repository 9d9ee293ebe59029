"""Bounds of errors with several causes, against draws."""

import numpy as np
import pytest

from semloc_jax.evaluation.mixture_bounds import Causes, beyond, bounds

GAUSSIAN = np.full((3, 3), np.inf)
MIXED = Causes(
    np.array([0.9, 0.07, 0.03]),
    np.array([[0.0, 0.0, 0.0], [0.3, -2.0, 0.0], [0.0, 1.0, 0.4]]),
    np.array([[0.02, 0.1, 0.05], [0.1, 0.2, 0.1], [0.5, 0.05, 0.2]]),
    GAUSSIAN,
)


def draws(causes: Causes, num: int) -> np.ndarray:
    random = np.random.default_rng(0)
    cause = random.choice(len(causes.probability), num, p=causes.probability)
    return causes.mean[cause] + causes.sigma[cause] * random.normal(size=(num, 3))


def test_a_mixture_exceeds_its_bounds_as_often_as_the_risk_says():
    errors = np.abs(draws(MIXED, 200_000))
    for risk in (0.3, 0.06, 0.006):
        share = (errors > bounds(MIXED, risk)).mean(axis=0)
        assert share == pytest.approx(np.full(3, risk / 3.0), rel=0.12)


def test_a_fault_below_the_risk_does_not_count_and_one_above_it_does():
    sound = Causes(np.ones(1), np.zeros((1, 3)), np.full((1, 3), 0.1), GAUSSIAN[:1])

    def along_m(probability: float) -> float:
        mean = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
        both = Causes(np.array([1.0 - probability, probability]), mean, np.full((2, 3), 0.1), GAUSSIAN[:2])
        return float(bounds(both, risk=3e-3)[1])

    assert along_m(1e-5) == pytest.approx(bounds(sound, risk=3e-3)[1], rel=1e-2)
    assert 2.0 < along_m(1e-2) < 2.2


def test_the_probability_of_an_error_is_that_of_draws():
    limits = np.array([0.29, 0.29, 0.5])
    share = (np.abs(draws(MIXED, 200_000)) > limits).mean(axis=0)
    assert beyond(MIXED, limits) == pytest.approx(share, rel=0.05)


def test_few_degrees_of_freedom_have_heavy_tails_and_nothing_finite_gives_no_bound():
    few = Causes(np.ones(1), np.zeros((1, 3)), np.full((1, 3), 0.1), np.full((1, 3), 10.0))
    assert bounds(few) == pytest.approx(np.full(3, 0.53), abs=0.01)  # 1.5 times that of a Gaussian
    assert np.isinf(bounds(few._replace(sigma=np.full((1, 3), np.nan)))).all()
