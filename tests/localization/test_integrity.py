"""Protection levels: their risk, alert limits; against draws."""

import numpy as np
import pytest

from semloc_jax.evaluation.metrics import ALERT_LIMITS
from semloc_jax.localization.integrity import (
    IntegrityConfig,
    ProtectionLevels,
    beyond_alert,
    protection_levels,
    with_map_accuracy,
)

COVARIANCE = np.diag([0.04, 0.01, 0.02, 0.002, 0.002, 0.003]) ** 2
WIDE = IntegrityConfig(risk=0.03, overbound=1.0)


def share_beyond(errors, levels):
    """Share of errors (x, y, yaw [m, rad]) with any direction beyond its level."""
    bounds = np.array([levels.longitudinal_m, levels.lateral_m, np.radians(levels.heading_deg)])
    return np.mean((np.abs(errors) > bounds).any(axis=1))


def test_levels_are_exceeded_as_often_as_the_risk_says():
    errors = np.random.default_rng(0).normal(size=(100_000, 3)) * np.sqrt(np.diag(COVARIANCE))[[0, 1, 5]]
    levels = protection_levels(COVARIANCE, WIDE)
    assert share_beyond(errors, levels) == pytest.approx(0.03, abs=0.002)
    assert levels.lateral_m == pytest.approx(0.01 * 2.576, rel=0.01)  # 1 % in two tails
    assert share_beyond(errors, protection_levels(COVARIANCE, IntegrityConfig(risk=1e-3, overbound=1.0))) < 2e-3
    doubled = protection_levels(COVARIANCE, IntegrityConfig(risk=0.03, overbound=2.0))
    assert np.allclose(doubled, 2.0 * np.array(levels))


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
