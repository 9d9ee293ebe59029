"""Where to start: even coverage of the window, the prior itself first, seeds that repeat."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import qmc

from semloc_jax.alignment.proposals import displaced, propose, rank1_lattice
from semloc_jax.geometry import lie

T_PRIOR = jnp.asarray(lie.exp(np.array([5.0, -3.0, 0.4, 0.02, -0.01, 2.1])))
SIGMA = jnp.array([1.5, 0.8, 0.05])
KEY = jax.random.key(0)


def offsets(Ts):
    """Displacements (x, y [m], heading [rad]) in the frame of the prior."""
    T = np.linalg.inv(np.asarray(T_PRIOR)) @ np.asarray(Ts)
    return np.column_stack([T[:, 0, 3], T[:, 1, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])


@pytest.mark.parametrize("num", [64, 256, 1024])
def test_lattice_is_far_more_even_than_chance(num):
    """Centred discrepancy (scipy's) below a fifth of that of random points."""
    points = np.asarray(rank1_lattice(num, np.dtype(np.float64)))
    assert points.min() >= 0 and points.max() < 1
    chance = np.mean([qmc.discrepancy(np.random.default_rng(s).random((num, 3))) for s in range(5)])
    assert qmc.discrepancy(points) < 0.2 * chance


def test_no_two_points_of_the_lattice_share_a_coordinate():
    points = np.asarray(rank1_lattice(1024, np.dtype(np.float64)))
    for axis in range(3):
        # A grid of 1024 points has 10 values on each axis; here neighbours are about 1/1024 apart.
        assert np.diff(np.sort(points[:, axis])).min() > 0.05 / 1024
        assert np.diff(np.sort(points[:, axis])).max() < 6.0 / 1024


def test_float32_lattice_is_the_float64_one():
    short, exact = (np.asarray(rank1_lattice(4096, np.dtype(kind))) for kind in (np.float32, np.float64))
    assert short.dtype == np.float32 and short.max() < 1.0
    apart = np.abs(short - exact)
    assert np.minimum(apart, 1.0 - apart).max() < 5e-4  # 0 and 1 are one place


def test_window_is_filled_to_its_corners():
    found = offsets(propose("lattice", 1024, T_PRIOR, SIGMA, 2.5, KEY)) / (2.5 * np.asarray(SIGMA))
    assert np.abs(found).max() <= 1.0 + 1e-6
    cells, _ = np.histogramdd(found, bins=[4, 4, 4], range=[(-1, 1)] * 3)
    assert cells.min() >= 8 and cells.max() <= 25  # 16 on average


def test_largest_hole_of_the_window():
    """Anywhere in the window of +-2.5 m, 2.5 m, 5 deg there is a start within 0.7 m and 1.4 deg."""
    sigma = jnp.array([1.0, 1.0, np.radians(2.0)])
    found = offsets(propose("lattice", 1024, T_PRIOR, sigma, 2.5, KEY))
    rng = np.random.default_rng(0)
    probes = rng.uniform(-2.5, 2.5, (2000, 3)) * np.asarray(sigma)
    scaled = (probes[:, None] - found[None]) / [0.7, 0.7, np.radians(1.4)]
    assert np.sqrt((scaled**2).sum(axis=2)).min(axis=1).max() < 1.0


def test_along_the_lane_is_twice_as_long_and_half_as_wide():
    found = offsets(propose("along_lane", 1024, T_PRIOR, SIGMA, 2.5, KEY)) / np.asarray(SIGMA)
    np.testing.assert_allclose(np.abs(found).max(axis=0), [5.0, 1.25, 2.5], rtol=0.01)


@pytest.mark.parametrize("kind", ["lattice", "gaussian", "along_lane"])
def test_the_first_start_is_the_prior_and_all_stay_in_its_plane(kind):
    Ts = propose(kind, 64, T_PRIOR, SIGMA, 2.5, KEY)
    assert Ts.shape == (64, 4, 4)
    np.testing.assert_allclose(Ts[0], T_PRIOR, atol=1e-12)
    inside = np.linalg.inv(np.asarray(T_PRIOR)) @ np.asarray(Ts)
    np.testing.assert_allclose(inside[:, 2, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(inside[:, 2, :3], np.tile([0.0, 0.0, 1.0], (64, 1)), atol=1e-12)


def test_gaussian_starts_have_the_sigmas_of_the_prior_and_repeat_with_their_key():
    Ts = propose("gaussian", 4096, T_PRIOR, SIGMA, 4.0, KEY)
    found = offsets(Ts)
    np.testing.assert_allclose(found.std(axis=0), SIGMA, rtol=0.05)
    assert np.all(np.abs(found.mean(axis=0)) < 3.5 * np.asarray(SIGMA) / 64)
    assert np.array_equal(Ts, propose("gaussian", 4096, T_PRIOR, SIGMA, 4.0, jax.random.key(0)))
    other = propose("gaussian", 4096, T_PRIOR, SIGMA, 4.0, jax.random.key(1))
    assert np.abs(offsets(other) - found)[1:].min(axis=1).max() > 0.1
    clipped = offsets(propose("gaussian", 4096, T_PRIOR, SIGMA, 1.0, KEY)) / np.asarray(SIGMA)
    assert np.abs(clipped).max() <= 1.0 + 1e-9


def test_displacement_is_in_the_frame_of_the_vehicle():
    moved = displaced(T_PRIOR, jnp.array([[2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.3]]))
    forward, left = np.asarray(T_PRIOR)[:3, 0], np.asarray(T_PRIOR)[:3, 1]
    np.testing.assert_allclose(moved[0, :3, 3], T_PRIOR[:3, 3] + 2.0 * forward, atol=1e-12)
    np.testing.assert_allclose(moved[1, :3, 3], T_PRIOR[:3, 3] + left, atol=1e-12)
    turned = np.asarray(T_PRIOR)[:3, :3].T @ np.asarray(moved[2])[:3, :3]
    assert np.arctan2(turned[1, 0], turned[0, 0]) == pytest.approx(0.3)
