"""Sigmas and directions from an information matrix with a known null space."""

import numpy as np

from semloc_jax.calibration.observability import Knowledge, observe, to_text

NAMES = ("front x", "front yaw", "rear x", "rear yaw")
PRIOR = np.array([0.05, 2.0, 0.05, 2.0])


def observed():
    """Cameras that are known against each other along x, and each about the vertical: x of both is free."""
    across = np.array([1.0, 0.0, -1.0, 0.0]) / np.sqrt(2.0)
    evidence = 99.0 * np.outer(across, across) + np.diag([0.0, 399.0, 0.0, 24.0])
    changes = np.array([0.01, 0.5, -0.01, 0.1])
    return observe(np.eye(4) + evidence, NAMES, ("m", "deg", "m", "deg"), changes, PRIOR, 0.35, 0.8)


def test_what_is_free_is_named_with_the_reason():
    seen = observed()
    assert [d.verdict for d in seen.directions] == [Knowledge.OBSERVABLE] * 3 + [Knowledge.HELD]
    assert seen.directions[-1].text == "x of all cameras together"
    assert "curves" in seen.directions[-1].reason
    assert "x of all cameras together" in to_text(seen) and "3 of 4 independent" in to_text(seen)


def test_sigmas_are_those_of_the_inverse():
    seen = observed()
    # x of one camera: half of its variance is that of both together, half that of the difference.
    assert np.isclose(seen.parameter("front x").sigma, 0.05 * np.sqrt(0.5 * (1.0 + 0.01)))
    assert np.isclose(seen.parameter("front yaw").sigma, 2.0 / 20.0)
    assert seen.parameter("front x").verdict is Knowledge.WEAK
    assert np.isclose(np.sqrt(seen.covariance[3, 3]), 2.0 / 5.0)
