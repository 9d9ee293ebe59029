"""Square roots of information: exact, and there where rounding leaves a covariance without a root."""

import numpy as np
import pytest

from semloc_jax.fusion.window_state import sqrt_information


def correlated(least: float) -> np.ndarray:
    """A covariance of a wide search: metres and degrees, two directions nearly dependent."""
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))
    scale = np.array([1.8, 2.3, 0.08, 0.017, 0.012, 0.24])
    scaled = (turn * [least, 0.09, 0.76, 1.1, 1.5, 2.6]) @ turn.T
    return scaled * np.outer(scale, scale)


def test_it_whitens_a_sound_covariance():
    covariance = correlated(0.01)
    root = sqrt_information(covariance)
    np.testing.assert_allclose(root @ covariance @ root.T, np.eye(6), atol=1e-9)


@pytest.mark.parametrize("least", [-2.3e-4, 0.0])
def test_what_rounding_made_indefinite_is_no_surer_than_rounding(least):
    """A track on a country road under fixes of 5 m noise stopped the whole run."""
    covariance = correlated(least)
    covariance[0, 1] += 1e-3  # an inverse in float32 is not symmetric, either
    root = sqrt_information(covariance)
    assert np.isfinite(root).all()
    told = np.linalg.inv(root.T @ root)
    scale = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(told / np.outer(scale, scale)).min() > 0.0
    # Other directions are as open as they were, to a few percent.
    np.testing.assert_allclose(np.sqrt(np.diag(told)), scale, rtol=0.05)
