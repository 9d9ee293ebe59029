"""Modes in the map frame: local origin undone, doubles dropped, neighbours merged by their moments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.alignment.hypotheses import Modes
from semloc_jax.alignment.modes import modes_in_map, orthonormal
from semloc_jax.alignment.same_pose import ONE_PLACE
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.structs import PoseEstimate

ORIGIN = np.array([431000.25, 5412000.5, 210.0])
HERE = LocalFrame(np.zeros(3))


def T_of(x=0.0, y=0.0, z=0.0, yaw_deg=0.0, pitch_deg=0.0):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZY", [yaw_deg, pitch_deg], degrees=True).as_matrix()
    T[:3, 3] = x, y, z
    return T


def modes_of(Ts, scores, weights, sigmas=None):
    """Solver modes at these poses; the other columns are told apart by their place."""
    n = len(Ts)
    sigmas = np.full((n, 6), 0.1) if sigmas is None else np.asarray(sigmas)
    ramp = jnp.arange(n, dtype=jnp.float32) / 10
    estimates = PoseEstimate(
        T_local_base=jnp.asarray(np.stack(Ts), jnp.float32),
        covariance=jnp.asarray(np.stack([np.diag(s**2) for s in sigmas]), jnp.float32),
        cost=ramp,
        coverage=1 - ramp,
        inlier_ratio=1 - 0.5 * ramp,
        information_eigenvalues=jnp.ones((n, 6), jnp.float32),
        weak_direction=jnp.eye(6, dtype=jnp.float32)[np.arange(n) % 6],
        num_steps=jnp.arange(n),
        status=jnp.zeros(n, int),
    )
    return Modes(estimates, jnp.asarray(scores, jnp.float32), jnp.asarray(weights, jnp.float32))


def test_poses_come_back_to_the_map_in_full_precision():
    """Millimetres survive at coordinates of millions, and rotations are rotations to the last digit."""
    T = T_of(12.3456, -7.6543, 0.5, 33.3, 1.2)
    (mode,) = modes_in_map(modes_of([T], [3.0], [1.0]), LocalFrame(ORIGIN), ONE_PLACE)
    np.testing.assert_allclose(mode.T_map_base[:3, 3], T[:3, 3] + ORIGIN, atol=2e-6)
    R = mode.T_map_base[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(R, T[:3, :3], atol=1e-6)
    assert mode.weight == 1.0 and mode.score == 3.0 and mode.coverage == 1.0
    assert (mode.sigma_longitudinal_m, mode.sigma_lateral_m) == pytest.approx((0.1, 0.1))
    assert mode.sigma_heading_deg == pytest.approx(np.degrees(0.1))


def test_nearest_rotation_is_the_polar_one():
    rng = np.random.default_rng(0)
    T = T_of(1, 2, 3, 40.0, 5.0)
    noisy = T.copy()
    noisy[:3, :3] += rng.normal(size=(3, 3)) * 1e-4
    given = orthonormal(noisy)[:3, :3]
    assert np.linalg.det(given) == pytest.approx(1.0, abs=1e-14)
    # No rotation in a small neighbourhood is nearer.
    best = np.linalg.norm(given - noisy[:3, :3])
    for step in rng.normal(size=(50, 3)) * 1e-3:
        assert np.linalg.norm(given @ Rotation.from_rotvec(step).as_matrix() - noisy[:3, :3]) > best


def test_two_solves_in_one_place_count_once():
    Ts = [T_of(), T_of(0.02, 0.0, 0.0, 0.05), T_of(5.0)]
    modes = modes_in_map(modes_of(Ts, [1.0, 1.1, 2.0], [0.4, 0.4, 0.2]), LocalFrame(ORIGIN), ONE_PLACE)
    assert [mode.weight for mode in modes] == pytest.approx([2 / 3, 1 / 3])
    assert [mode.score for mode in modes] == [1.0, 2.0]


def test_neighbours_are_merged_by_their_moments():
    """By hand: shares 3/4 and 1/4 of a pair 0.4 m apart along x: mean at 0.1 m, spread 0.4^2 x 3/16."""
    sigmas = np.array([[0.1, 0.2, 0.01, 0.01, 0.01, 0.002], [0.3, 0.2, 0.01, 0.01, 0.01, 0.002], [0.1] * 6])
    Ts = [T_of(0.0, 0.0, 0.0, 90.0), T_of(0.0, 0.4, 0.0, 90.0), T_of(0.0, 4.0, 0.0, 90.0)]
    modes = modes_in_map(modes_of(Ts, [1.0, 2.0, 3.0], [0.6, 0.2, 0.2], sigmas), HERE, ONE_PLACE)
    assert [mode.weight for mode in modes] == pytest.approx([0.8, 0.2])
    merged = modes[0]
    # The vehicle looks along +y of the map, so the pair is apart along its own x.
    np.testing.assert_allclose(merged.T_map_base[:2, 3], [0.0, 0.1], atol=1e-6)
    variance = 0.75 * 0.1**2 + 0.25 * 0.3**2 + 0.4**2 * 3 / 16
    assert merged.covariance[0, 0] == pytest.approx(variance, rel=1e-5)
    assert merged.covariance[1, 1] == pytest.approx(0.04, rel=1e-5)
    assert merged.score == 1.0  # that of the best one


def test_headings_are_merged_too():
    Ts = [T_of(0, 0, 0, 10.0), T_of(0, 0, 0, 10.8)]
    sigmas = np.full((2, 6), 1e-3)
    (mode,) = modes_in_map(modes_of(Ts, [1.0, 1.5], [0.5, 0.5], sigmas), HERE, ONE_PLACE)
    yaw = np.degrees(np.arctan2(mode.T_map_base[1, 0], mode.T_map_base[0, 0]))
    assert yaw == pytest.approx(10.4, abs=1e-4)
    assert mode.sigma_heading_deg == pytest.approx(np.hypot(np.degrees(1e-3), 0.4), rel=1e-3)


@pytest.mark.parametrize(("x", "yaw_deg", "count"), [(0.59, 0.0, 1), (0.61, 0.0, 2), (0.1, 1.17, 1), (0.1, 1.19, 2)])
def test_what_is_one_place(x, yaw_deg, count):
    Ts = [T_of(), T_of(x, 0.0, 0.0, yaw_deg)]
    assert len(modes_in_map(modes_of(Ts, [1.0, 1.2], [0.6, 0.4]), HERE, ONE_PLACE)) == count


def test_the_heaviest_mode_comes_first_even_if_another_fits_better():
    """Two broad neighbours that fit a little worse hold more of the posterior than one sharp pose."""
    Ts = [T_of(), T_of(3.0), T_of(3.3)]
    modes = modes_in_map(modes_of(Ts, [1.0, 1.2, 1.3], [0.4, 0.3, 0.3]), HERE, ONE_PLACE)
    assert [mode.weight for mode in modes] == pytest.approx([0.6, 0.4])
    assert modes[0].T_map_base[0, 3] == pytest.approx(3.15, abs=1e-5)


def test_empty_slots_and_poses_that_are_no_numbers_are_no_modes():
    Ts = [T_of(), T_of(5.0), np.full((4, 4), np.nan)]
    modes = modes_in_map(modes_of(Ts, [1.0, np.inf, 2.0], [0.7, 0.0, 0.3]), HERE, ONE_PLACE)
    assert len(modes) == 1 and modes[0].weight == 1.0
    nothing = modes_of([np.full((4, 4), np.nan)], [np.nan], [0.0])
    assert modes_in_map(nothing, HERE, ONE_PLACE) == ()


def test_modes_may_come_from_the_device():
    found = jax.device_put(modes_of([T_of()], [1.0], [1.0]))
    assert isinstance(modes_in_map(found, HERE, ONE_PLACE)[0].T_map_base, np.ndarray)
