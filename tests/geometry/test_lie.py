"""Rigid motions against scipy's matrix exponential and rotations.

What a test needs of JAX is one compiled function: operation by operation, these tests compile 1,254 programs.
"""

import jax
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from semloc_jax.geometry import lie
from tests.compiling import jit_quickly

SMALL_AND_LARGE = [0.0, 1e-12, 1e-7, 1e-4, 0.03, 0.5, 2.0, 3.1]


def tangents(size, num=5, seed=0):
    """Tangents (v, omega) whose rotation has a given angle."""
    rng = np.random.default_rng(seed)
    xi = rng.normal(size=(num, 6))
    xi[:, 3:] *= size / np.linalg.norm(xi[:, 3:], axis=1, keepdims=True)
    return xi


def hat(xi):
    v, w = xi[:3], xi[3:]
    return np.block([[np.cross(np.eye(3), w), v[:, None]], [np.zeros((1, 4))]])


@jit_quickly
def there_and_back(xi):
    T = lie.exp(xi)
    return T, lie.log(T), lie.so3_exp(xi[:, 3:]), lie.so3_log(T[:, :3, :3])


@pytest.mark.parametrize("size", SMALL_AND_LARGE)
def test_exp_is_the_matrix_exponential_and_log_its_inverse(size):
    xi = tangents(size)
    T, xi_back, R, omega_back = there_and_back(xi)
    assert np.allclose(T, [expm(hat(x)) for x in xi], atol=1e-12)
    assert np.allclose(xi_back, xi, atol=1e-9)
    assert np.allclose(R, Rotation.from_rotvec(xi[:, 3:]).as_matrix(), atol=1e-12)
    assert np.allclose(omega_back, xi[:, 3:], atol=1e-9)


def test_translation_comes_first():
    """Moving along xi[0] moves the vehicle along its own x axis, xi[5] turns it to the left."""

    @jit_quickly
    def moved(xi):
        T = lie.compose(lie.se2_to_se3(10.0, 20.0, np.pi / 2), lie.exp(xi))
        return T, lie.yaw(T)

    assert np.allclose(moved(np.array([1.0, 0, 0, 0, 0, 0]))[0][:3, 3], [10.0, 21.0, 0.0])
    assert float(moved(np.array([0, 0, 0, 0, 0, 0.1]))[1]) == pytest.approx(np.pi / 2 + 0.1)


def test_compose_inverse_and_transform():
    T_a_b, T_b_c = (expm(hat(x)) for x in tangents(1.3, num=2))
    p_c = np.random.default_rng(0).normal(size=(7, 3))

    @jit_quickly
    def chained(T_a_b, T_b_c, p_c):
        T_a_c = lie.compose(T_a_b, T_b_c)
        p_a = lie.transform(T_a_c, p_c)
        return T_a_c, lie.inverse(T_a_b), p_a, lie.transform(lie.inverse(T_a_c), p_a)

    T_a_c, T_b_a, p_a, p_back = chained(T_a_b, T_b_c, p_c)
    assert np.allclose(T_a_c, T_a_b @ T_b_c)
    assert np.allclose(T_b_a, np.linalg.inv(T_a_b))
    assert np.allclose(p_a, (T_a_b @ T_b_c @ np.c_[p_c, np.ones(7)].T)[:3].T)
    assert np.allclose(p_back, p_c)


def test_batches_broadcast():
    Ts = np.array([expm(hat(x)) for x in tangents(0.7, num=4)])
    p = np.random.default_rng(0).normal(size=(9, 3))

    @jit_quickly
    def both(Ts, p):
        many = lie.transform(Ts[:, None], p), lie.inverse(Ts)
        return many, (lie.transform(Ts[2], p), lie.inverse(Ts[3]))

    (moved, inverses), (moved_by_one, inverse_of_one) = both(Ts, p)
    assert moved.shape == (4, 9, 3)
    assert np.allclose(moved[2], moved_by_one)
    assert np.allclose(inverses[3], inverse_of_one)


@jit_quickly
def jacobians(xi):
    """Jacobians of the package, each with the derivative it stands for; and the right one times its inverse."""
    omega = xi[3:]

    def left(d):
        return lie.so3_log(lie.so3_exp(omega + d) @ lie.so3_exp(omega).T)

    def right(d):
        return lie.so3_log(lie.so3_exp(omega).T @ lie.so3_exp(omega + d))

    def logarithm(d):
        return lie.log(lie.compose(lie.exp(xi), lie.exp(d)))

    return (
        (lie.so3_left_jacobian(omega), jax.jacfwd(left)(np.zeros(3))),
        (lie.so3_right_jacobian(omega), jax.jacfwd(right)(np.zeros(3))),
        (lie.se3_right_jacobian_inverse(xi), jax.jacfwd(logarithm)(np.zeros(6))),
    )


@pytest.mark.parametrize("size", SMALL_AND_LARGE)
def test_jacobians_are_derivatives(size):
    left, right, logarithm = jacobians(tangents(size, num=1)[0])
    assert np.allclose(*left, atol=1e-9)
    assert np.allclose(*right, atol=1e-9)
    assert np.allclose(*logarithm, atol=1e-7)


def test_adjoint_moves_a_tangent_to_the_other_side():
    T, xi = expm(hat(tangents(1.1, num=1)[0])), tangents(0.4, num=1, seed=3)[0]
    right, left = jit_quickly(lambda T, xi: (T @ lie.exp(xi), lie.exp(lie.adjoint(T) @ xi) @ T))(T, xi)
    assert np.allclose(right, left, atol=1e-12)


@pytest.mark.parametrize(
    "function",
    [
        lambda xi: lie.exp(xi),
        lambda xi: lie.log(lie.exp(xi)),
        lambda xi: lie.so3_log(lie.so3_exp(xi[3:])),
        lambda xi: lie.so3_left_jacobian(xi[3:]),
        lambda xi: lie.se3_right_jacobian_inverse(xi),
    ],
)
def test_gradients_are_finite_at_zero_in_the_type_of_the_input(function):
    def results(xi):
        return function(xi), jax.jacfwd(function)(xi), jax.jacrev(function)(xi)

    dtypes = [np.float32, np.float64]
    of_both = jit_quickly(lambda zeros: [results(xi) for xi in zeros])([np.zeros(6, dtype) for dtype in dtypes])
    for dtype, (value, *jacobians_at_zero) in zip(dtypes, of_both, strict=True):
        assert value.dtype == dtype
        for jacobian in jacobians_at_zero:
            assert jacobian.dtype == dtype
            assert np.isfinite(jacobian).all()


def test_log_of_exp_has_the_identity_as_derivative_at_zero():
    jacobian = jit_quickly(jax.jacrev(lambda xi: lie.log(lie.exp(xi))))(np.zeros(6))
    assert np.allclose(jacobian, np.eye(6), atol=1e-12)


def test_yaw_of_a_level_pose():
    angles = np.linspace(-3.1, 3.1, 9)

    @jit_quickly
    def level(angles):
        T = lie.se2_to_se3(1.0, 2.0, angles, z=0.5)
        return T, lie.yaw(T)

    T, yaw = level(angles)
    assert np.allclose(yaw, angles)
    assert np.allclose(T[:, :3, 3], [1.0, 2.0, 0.5])
