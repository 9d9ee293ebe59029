"""Robust planes: what the road is when a third of the points are not road."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.geometry.plane import fit_plane, signed_distance

SLOPE = np.array([0.04, -0.02])
NORMAL = np.array([-0.04, 0.02, 1.0]) / np.linalg.norm([0.04, 0.02, 1.0])


def road(num=200, noise_m=0.01, seed=0):
    """Points on a plane that climbs 4 % to the east."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-15, 15, (num, 2))
    return np.c_[xy, xy @ SLOPE + 3.0 + rng.normal(0, noise_m, num)]


def tilt_deg(plane):
    return float(np.degrees(np.arccos(np.clip(np.asarray(plane.normal) @ NORMAL, -1, 1))))


def test_exact_plane():
    plane = fit_plane(road(noise_m=0.0))
    assert tilt_deg(plane) < 1e-5
    assert np.abs(signed_distance(plane, road(noise_m=0.0, seed=5))).max() < 1e-9
    assert float(plane.rms_m) < 1e-7


def test_noise_is_averaged_out():
    """200 points with 1 cm of noise over 30 m: 0.01 / sqrt(200) / 8.7 m rad of tilt, about 0.005 deg."""
    plane = fit_plane(road())
    assert tilt_deg(plane) < 0.015
    assert float(plane.rms_m) == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize("seed", range(5))
def test_a_third_of_outliers_above_does_not_lift_the_plane(seed):
    points = road(seed=seed)
    rng = np.random.default_rng(100 + seed)
    points[:66, 2] += rng.uniform(0.15, 2.0, 66)
    plane = fit_plane(points)
    assert tilt_deg(plane) < 0.05
    height = signed_distance(plane, np.array([0.0, 0.0, 3.0]))
    assert abs(float(height)) < 0.01
    assert tilt_deg(fit_plane(points, noise_m=10.0)) > 0.05  # without robustness it would be lifted


def test_padding_has_no_effect():
    points = road()
    padded = np.concatenate([points, np.full((56, 3), 77.0)])
    weight = np.r_[np.ones(200), np.zeros(56)]
    assert np.allclose(fit_plane(padded, weight).normal, fit_plane(points).normal, atol=1e-12)


def test_normal_points_up_also_for_a_wall():
    wall = road()[:, [2, 0, 1]]
    assert fit_plane(wall).normal[2] >= 0


def test_compiled_float32_agrees_with_numpy():
    points = road()
    compiled = jax.jit(fit_plane)(jnp.asarray(points, jnp.float32))
    assert isinstance(compiled.normal, jax.Array)
    assert compiled.normal.dtype == np.float32
    assert np.allclose(compiled.normal, fit_plane(points).normal, atol=1e-5)
