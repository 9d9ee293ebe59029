"""Umeyama's motion against scipy and against known motions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.geometry.umeyama import umeyama


def pairs(num=40, scale=1.0, noise_m=0.0, dimension=3, seed=0):
    rng = np.random.default_rng(seed)
    p_b = rng.normal(size=(num, dimension)) * 5
    R = Rotation.from_rotvec([0.3, -1.1, 2.0]).as_matrix() if dimension == 3 else rotation_2d(2.2)
    t = np.arange(1.0, dimension + 1.0)
    return scale * p_b @ R.T + t + rng.normal(0, noise_m, p_b.shape), p_b, R, t


def rotation_2d(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("scale", [1.0, 1.7])
def test_known_motion(dimension, scale):
    p_a, p_b, R, t = pairs(scale=scale, dimension=dimension)
    found = umeyama(p_a, p_b, with_scale=scale != 1.0)
    assert float(found.scale) == pytest.approx(scale)
    assert np.allclose(found.R_a_b, R)
    assert np.allclose(found.t_a_b, t)
    assert np.allclose(found.apply(p_b), p_a)


def test_weighted_noise_equals_scipy():
    p_a, p_b, _, _ = pairs(noise_m=0.3)
    weight = np.random.default_rng(1).uniform(0, 1, len(p_a))
    found = umeyama(p_a, p_b, weight)
    mean_a, mean_b = np.average(p_a, axis=0, weights=weight), np.average(p_b, axis=0, weights=weight)
    expected, _ = Rotation.align_vectors(p_a - mean_a, p_b - mean_b, weights=weight)
    assert np.allclose(found.R_a_b, expected.as_matrix(), atol=1e-9)
    assert np.allclose(found.t_a_b, mean_a - expected.apply(mean_b))


@pytest.mark.parametrize("flat", [True, False])
def test_never_a_reflection(flat):
    """Mirrored pairs get the best rotation, points on one plane the true one."""
    p_a, p_b, R, t = pairs()
    if flat:
        p_b[:, 2] = 0.0
        p_a = p_b @ R.T + t
    else:
        p_a = p_a * [1, 1, -1]
    found = umeyama(p_a, p_b)
    assert np.linalg.det(found.R_a_b) == pytest.approx(1.0)
    if flat:
        assert np.allclose(found.R_a_b, R)


def test_padding_and_compilation():
    p_a, p_b, R, _ = pairs()
    weight = jnp.asarray(np.r_[np.ones(40), np.zeros(24)], jnp.float32)
    padded = [jnp.asarray(np.concatenate([p, np.full((24, 3), 9.0)]), jnp.float32) for p in (p_a, p_b)]
    found = jax.jit(umeyama)(*padded, weight)
    assert found.R_a_b.dtype == np.float32
    assert np.allclose(found.R_a_b, R, atol=2e-6)
