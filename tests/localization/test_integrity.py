"""Protection levels: their risk, alert limits; against draws."""

import numpy as np
import pytest

from semloc_jax.evaluation.metrics import ALERT_LIMITS
from semloc_jax.localization.integrity import (
    IntegrityConfig,
    ProtectionLevels,
    beyond_alert,
    map_sigmas,
    misleading,
    protection_levels,
)
from semloc_jax.maps import with_map_accuracy

COVARIANCE = np.diag([0.04, 0.01, 0.02, 0.002, 0.002, 0.003]) ** 2
WIDE = IntegrityConfig(risk=0.03)
KNOWN = np.full(3, 1e6)
"""Degrees of freedom of a scale that is known."""
NO_MAP = np.zeros(3)
AMPLE = np.full(3, np.inf)
"""Room that no level fills."""


def share_beyond(errors, levels):
    """Share of errors (x, y, yaw [m, rad]) with any direction beyond its level."""
    bounds = np.array([levels.longitudinal_m, levels.lateral_m, np.radians(levels.heading_deg)])
    return np.mean((np.abs(errors) > bounds).any(axis=1))


def test_levels_are_exceeded_as_often_as_the_risk_says():
    errors = np.random.default_rng(0).normal(size=(100_000, 3)) * np.sqrt(np.diag(COVARIANCE))[[0, 1, 5]]
    levels = protection_levels(COVARIANCE, KNOWN, NO_MAP, AMPLE, WIDE)
    assert share_beyond(errors, levels) == pytest.approx(0.03, abs=0.002)
    assert levels.lateral_m == pytest.approx(0.01 * 2.576, rel=0.01)  # 1 % in two tails
    assert share_beyond(errors, protection_levels(COVARIANCE, KNOWN, NO_MAP, AMPLE, IntegrityConfig(risk=1e-3))) < 2e-3


def test_levels_hold_where_the_scale_is_told_by_few_errors():
    """A sigma that comes from ten errors is often too small: Gaussian levels would be exceeded three times as often."""
    rng = np.random.default_rng(1)
    draws = rng.normal(size=(20_000, 3))
    scale = np.sqrt(rng.chisquare(10.0, size=(20_000, 3)) / 10.0)
    errors = draws / scale * np.sqrt(np.diag(COVARIANCE))[[0, 1, 5]]
    assert share_beyond(errors, protection_levels(COVARIANCE, np.full(3, 10.0), NO_MAP, AMPLE, WIDE)) == pytest.approx(
        0.03, abs=0.004
    )
    assert share_beyond(errors, protection_levels(COVARIANCE, KNOWN, NO_MAP, AMPLE, WIDE)) > 0.06


def test_risk_that_one_direction_does_not_need_is_left_to_the_others():
    """Across has room to spare, along has not: the levels fit in and errors exceed them as often as before."""
    equal = protection_levels(COVARIANCE, KNOWN, NO_MAP, AMPLE, WIDE)
    room = np.array([10.0 * equal.lateral_m, 0.95 * equal.longitudinal_m, 10.0 * equal.heading_deg])
    shared = protection_levels(COVARIANCE, KNOWN, NO_MAP, room, WIDE)
    assert (np.array(shared) <= room).all() and shared.lateral_m < 2.0 * equal.lateral_m
    errors = np.random.default_rng(2).normal(size=(100_000, 3)) * np.sqrt(np.diag(COVARIANCE))[[0, 1, 5]]
    assert share_beyond(errors, shared) == pytest.approx(0.03, abs=0.002)


def test_levels_that_do_not_fit_share_the_risk_equally():
    equal = protection_levels(COVARIANCE, KNOWN, NO_MAP, AMPLE, WIDE)
    for room in (0.5 * np.array(equal), np.array([1.0, -0.1, 1.0])):
        assert protection_levels(COVARIANCE, KNOWN, NO_MAP, room, WIDE) == equal


def test_what_the_maker_states_of_the_map_has_the_tails_of_a_gaussian():
    few = np.full(3, 4.0)
    of_map = protection_levels(np.zeros((6, 6)), few, map_sigmas(0.05, 0.0025), AMPLE, WIDE)
    assert of_map == pytest.approx((0.05 * 2.576, 0.05 * 2.576, np.degrees(0.0025) * 2.576), rel=1e-3)
    alone = protection_levels(COVARIANCE, few, NO_MAP, AMPLE, WIDE)
    both = protection_levels(COVARIANCE, few, map_sigmas(0.05, 0.0025), AMPLE, WIDE)
    np.testing.assert_allclose(both, np.hypot(alone, of_map))


def test_levels_beyond_the_alert_limits_are_named():
    street = IntegrityConfig().limit
    assert street == ALERT_LIMITS[0] and IntegrityConfig(alert_limits="freeway").limit.longitudinal_m == 1.4
    assert beyond_alert(ProtectionLevels(0.29, 0.2, 0.5), street) == ()
    reasons = beyond_alert(ProtectionLevels(0.1, 0.41, float("nan")), street)
    assert reasons[0] == "longitudinal protection level 0.41 m exceeds 0.29 m" and "heading" in reasons[1]


def test_the_accuracy_of_the_map_joins_the_pose():
    found = with_map_accuracy(COVARIANCE, 0.03, 0.0015)
    sigma = np.sqrt(np.diag(found))
    assert sigma[:2] == pytest.approx([0.05, np.hypot(0.01, 0.03)])
    assert sigma[5] == pytest.approx(np.hypot(0.003, 0.0015))
    assert np.array_equal(with_map_accuracy(COVARIANCE, 0.0, 0.0), COVARIANCE)


@pytest.mark.parametrize("fault", [(0.0, 0.0, 0.0), (0.0, 0.1, 0.2)])
def test_the_probability_of_misleading_is_that_of_draws_beside_a_fault(fault):
    rng, limit = np.random.default_rng(2), ALERT_LIMITS[0]
    scale = np.sqrt(rng.chisquare(10.0, size=(400_000, 3)) / 10.0)
    errors = rng.normal(size=(400_000, 3)) / scale * np.sqrt(np.diag(COVARIANCE))[[1, 0, 5]]
    errors = np.abs(errors * [1.0, 1.0, np.degrees(1.0)] + fault)
    beyond = (errors > [limit.lateral_m, limit.longitudinal_m, limit.heading_deg]).mean(axis=0).sum()
    stated = misleading(COVARIANCE, np.full(3, 10.0), NO_MAP, np.array(fault), limit)
    assert stated == pytest.approx(beyond, rel=0.05)
