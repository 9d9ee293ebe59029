"""The numpy twin of the rigid motions against scipy's matrix exponential and against `lie`."""

import numpy as np
import pytest
from scipy.linalg import expm

from semloc_jax.geometry import lie, rigid

SIZES = [0.0, 1e-12, 1e-7, 0.0099, 0.0101, 0.5, 2.0, 3.0]


def tangents(size, num=4, seed=0):
    rng = np.random.default_rng(seed)
    xi = rng.normal(size=(num, 6)) * 3
    xi[:, 3:] *= size / np.linalg.norm(xi[:, 3:], axis=1, keepdims=True)
    return xi


def hat(xi):
    return np.block([[rigid.skew(xi[3:]), xi[:3, None]], [np.zeros((1, 4))]])


@pytest.mark.parametrize("size", SIZES)
def test_exp_is_the_matrix_exponential_and_log_its_inverse(size):
    xi = tangents(size)
    T = rigid.exp(xi)
    assert np.allclose(T, [expm(hat(x)) for x in xi], atol=1e-12)
    assert np.allclose(rigid.log(T), xi, atol=1e-9)
    assert np.allclose(rigid.inverse(T) @ T, np.eye(4), atol=1e-12)
    for one, motion in zip(xi, T, strict=True):  # alone they are computed another way
        assert np.allclose(rigid.exp(one), motion, atol=1e-14) and np.allclose(rigid.log(motion), one, atol=1e-9)


def test_same_numbers_as_the_jax_room():
    xi = tangents(1.2)
    T = rigid.exp(xi)
    assert np.allclose(T, lie.exp(xi), atol=1e-12)
    assert np.allclose(rigid.log(T), lie.log(T), atol=1e-9)
    assert np.allclose(rigid.adjoint(T), lie.adjoint(T), atol=1e-12)
    assert np.allclose(np.linalg.inv(rigid.right_jacobian(xi)), lie.se3_right_jacobian_inverse(xi), atol=1e-9)


@pytest.mark.parametrize("size", [1e-6, 0.3, 2.5])
def test_right_jacobian_is_the_derivative_of_exp(size):
    xi, step = tangents(size, num=1)[0], 1e-6
    for axis in range(6):
        d = step * np.eye(6)[axis]
        moved = rigid.log(rigid.inverse(rigid.exp(xi - d)) @ rigid.exp(xi + d)) / (2 * step)
        assert np.allclose(rigid.right_jacobian(xi)[:, axis], moved, atol=1e-7)


def test_normalised_removes_rounding():
    T = rigid.exp(tangents(0.7)[0])
    rough = T + 1e-6 * np.pad(np.ones((3, 3)), (0, 1))
    R = rigid.normalised(rough)[:3, :3]
    assert np.allclose(R.T @ R, np.eye(3), atol=1e-14)
    assert np.allclose(R, T[:3, :3], atol=3e-6)


def test_cross_products_are_those_of_numpy_also_of_one_and_many():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 5, 3))
    np.testing.assert_allclose(rigid.cross(a, b), np.cross(a, b), atol=1e-15)
    np.testing.assert_allclose(rigid.cross(a[:, None], b[None]), np.cross(a[:, None], b[None]), atol=1e-15)
