"""Integrity figures: NEES band, correlated frames, Stanford fields, against draws whose truth is known."""

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.integrity import (
    hourly_risk,
    independent_frames,
    integrity_metrics,
    nees,
    normalised_squares,
    sigma_coverage,
    stanford_counts,
)


def draws(num=4000, seed=0):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(num, 3, 3)) + 2.0 * np.eye(3)
    covariance = A @ A.transpose(0, 2, 1)
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.normal(size=(num, 3)))
    return errors, covariance


def is_consistent(report):
    return report.low <= report.mean <= report.high


def test_nees_is_one_for_true_covariances_and_tells_wrong_ones():
    errors, covariance = draws()
    right = nees(normalised_squares(errors, covariance), 3)
    assert is_consistent(right) and right.mean == pytest.approx(1.0, abs=0.05)
    small = nees(normalised_squares(errors, 0.5 * covariance), 3)
    assert small.mean == pytest.approx(2.0, abs=0.1) and not is_consistent(small) and small.mean > small.high
    large = nees(normalised_squares(errors, 2.0 * covariance), 3)
    assert large.mean < large.low
    with pytest.raises(SemlocError, match="no frames"):
        nees(np.zeros(0), 3)


def test_the_band_holds_95_percent_of_runs():
    rng = np.random.default_rng(1)
    inside = [is_consistent(nees(np.sum(rng.normal(size=(50, 3)) ** 2, axis=1), 3)) for _ in range(1000)]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)


def test_correlated_frames_count_for_fewer():
    """A first-order process with correlation r is worth n (1 - r) / (1 + r) independent frames."""
    rng = np.random.default_rng(2)
    white = rng.normal(size=(4000, 3))
    assert independent_frames(white) == pytest.approx(4000, rel=0.05)
    slow = np.zeros_like(white)
    for k in range(1, len(white)):
        slow[k] = 0.8 * slow[k - 1] + 0.6 * white[k]
    assert independent_frames(slow) == pytest.approx(4000 / 9.0, rel=0.25)
    wide = nees(np.sum(slow**2, axis=1), 3, num_independent=independent_frames(slow))
    narrow = nees(np.sum(slow**2, axis=1), 3)
    assert is_consistent(wide) and wide.high - wide.low == pytest.approx(3 * (narrow.high - narrow.low), rel=0.25)


def test_three_sigma_hold_997_of_1000():
    errors, covariance = draws(20000, 3)
    sigma = np.sqrt(covariance[:, 0, 0])
    assert sigma_coverage(errors[:, 0], sigma) == pytest.approx(0.9973, abs=0.0012)
    assert np.isnan(sigma_coverage(np.zeros(0), np.zeros(0)))


def test_each_field_of_the_stanford_diagram():
    #       available, bounded but too large, misleading inside, misleading beyond, hazardous
    error = np.array([0.1, -0.4, -0.2, 0.9, 0.5])
    level = np.array([0.2, 0.6, 0.1, 0.8, 0.2])
    counts = stanford_counts(error, level, 0.3)
    assert (counts.available, counts.unavailable, counts.misleading, counts.hazardous) == (1, 1, 2, 1)
    assert counts.num_frames == 5


def test_metrics_count_frames_that_are_not_offered_as_unavailable():
    error, sigma, level = np.array([0.1, 0.1, 5.0, 0.1]), np.full(4, 0.05), np.full(4, 0.2)
    tracked = np.array([True, True, False, False])
    values = {m.key: m.value for m in integrity_metrics("lateral", error, sigma, level, 0.3, tracked)}
    assert values["integrity.lateral.available"] == 0.5 and values["integrity.lateral.unavailable"] == 0.5
    assert values["integrity.lateral.hazardous"] == 0.0 and values["integrity.lateral.in_3_sigma"] == 0.75
    values = {m.key: m.value for m in integrity_metrics("lateral", error, sigma, level, 0.3)}
    assert values["integrity.lateral.hazardous"] == 0.25


def test_an_hour_of_poses_is_bounded_by_what_was_driven():
    """Ten minutes at 10 Hz without an error: less than 18 an hour (the rule of three); what is stated counts once for
    each independent frame."""
    num = 6000
    risk = hourly_risk(np.full(num, 1e-4), np.zeros(num, bool), 0.1, num_independent=600.0)
    assert risk.hours == pytest.approx(1.0 / 6.0) and risk.seen == 0.0
    assert risk.below == pytest.approx(18.0, rel=0.01)
    assert risk.stated == pytest.approx(600.0 * 1e-4 * 6.0)


def test_a_stretch_of_wrong_frames_is_one_event():
    is_wrong = np.zeros(6000, bool)
    is_wrong[100:130] = is_wrong[0] = is_wrong[-1] = True
    risk = hourly_risk(np.full(6000, 1e-4), is_wrong, 0.1, 600.0)
    assert risk.seen == pytest.approx(3 * 6.0)
    # At a rate of `below` no more than three events are seen in one drive of twenty.
    drives = np.random.default_rng(0).poisson(risk.below / 6.0, 100_000)
    assert np.mean(drives <= 3) == pytest.approx(0.05, abs=0.005)
    with pytest.raises(SemlocError, match="no frames that were offered"):
        hourly_risk(np.zeros(0), np.zeros(0, bool), 0.1, 1.0)
