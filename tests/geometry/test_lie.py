"""Rigid motions against scipy's matrix exponential and rotations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from semloc_jax.geometry import lie

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


@pytest.mark.parametrize("size", SMALL_AND_LARGE)
def test_exp_is_the_matrix_exponential_and_log_its_inverse(size):
    xi = tangents(size)
    T = lie.exp(xi)
    assert np.allclose(T, [expm(hat(x)) for x in xi], atol=1e-12)
    assert np.allclose(lie.log(T), xi, atol=1e-9)
    assert np.allclose(lie.so3_exp(xi[:, 3:]), Rotation.from_rotvec(xi[:, 3:]).as_matrix(), atol=1e-12)
    assert np.allclose(lie.so3_log(T[:, :3, :3]), xi[:, 3:], atol=1e-9)


def test_translation_comes_first():
    """Moving along xi[0] moves the vehicle along its own x axis, xi[5] turns it to the left."""
    T_map_base = lie.se2_to_se3(10.0, 20.0, np.pi / 2)
    ahead = lie.compose(T_map_base, lie.exp(np.array([1.0, 0, 0, 0, 0, 0])))
    assert np.allclose(ahead[:3, 3], [10.0, 21.0, 0.0])
    turned = lie.compose(T_map_base, lie.exp(np.array([0, 0, 0, 0, 0, 0.1])))
    assert float(lie.yaw(turned)) == pytest.approx(np.pi / 2 + 0.1)


def test_compose_inverse_and_transform():
    T_a_b, T_b_c = (np.asarray(lie.exp(x)) for x in tangents(1.3, num=2))
    p_c = np.random.default_rng(0).normal(size=(7, 3))
    T_a_c = lie.compose(T_a_b, T_b_c)
    assert np.allclose(T_a_c, T_a_b @ T_b_c)
    assert np.allclose(lie.inverse(T_a_b), np.linalg.inv(T_a_b))
    assert np.allclose(lie.transform(T_a_c, p_c), (T_a_b @ T_b_c @ np.c_[p_c, np.ones(7)].T)[:3].T)
    assert np.allclose(lie.transform(lie.inverse(T_a_c), lie.transform(T_a_c, p_c)), p_c)


def test_batches_broadcast():
    Ts = lie.exp(tangents(0.7, num=4))
    p = np.random.default_rng(0).normal(size=(9, 3))
    moved = lie.transform(Ts[:, None], p)
    assert moved.shape == (4, 9, 3)
    assert np.allclose(moved[2], lie.transform(Ts[2], p))
    assert np.allclose(lie.inverse(Ts)[3], lie.inverse(Ts[3]))


@pytest.mark.parametrize("size", SMALL_AND_LARGE)
def test_jacobians_are_derivatives(size):
    xi = tangents(size, num=1)[0]
    omega = xi[3:]
    zero3, zero6 = jnp.zeros(3), jnp.zeros(6)

    def left(d):
        return lie.so3_log(lie.so3_exp(omega + d) @ lie.so3_exp(omega).T)

    def right(d):
        return lie.so3_log(lie.so3_exp(omega).T @ lie.so3_exp(omega + d))

    def logarithm(d):
        return lie.log(lie.compose(lie.exp(xi), lie.exp(d)))

    assert np.allclose(lie.so3_left_jacobian(omega), jax.jacfwd(left)(zero3), atol=1e-9)
    assert np.allclose(lie.so3_right_jacobian(omega), jax.jacfwd(right)(zero3), atol=1e-9)
    assert np.allclose(lie.so3_right_jacobian(omega) @ lie.so3_right_jacobian_inverse(omega), np.eye(3), atol=1e-9)
    assert np.allclose(lie.se3_right_jacobian_inverse(xi), jax.jacfwd(logarithm)(zero6), atol=1e-7)


def test_adjoint_moves_a_tangent_to_the_other_side():
    T = lie.exp(tangents(1.1, num=1)[0])
    xi = tangents(0.4, num=1, seed=3)[0]
    assert np.allclose(T @ lie.exp(xi), lie.exp(lie.adjoint(T) @ xi) @ T, atol=1e-12)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "function",
    [
        lambda xi: lie.exp(xi),
        lambda xi: lie.log(lie.exp(xi)),
        lambda xi: lie.so3_log(lie.so3_exp(xi[3:])),
        lambda xi: lie.so3_left_jacobian(xi[3:]),
        lambda xi: lie.so3_right_jacobian_inverse(xi[3:]),
        lambda xi: lie.se3_right_jacobian_inverse(xi),
        lambda xi: lie.to_quaternion_xyzw(lie.exp(xi)),
    ],
)
def test_gradients_are_finite_at_zero_in_the_type_of_the_input(function, dtype):
    xi = jnp.zeros(6, dtype)
    assert function(xi).dtype == dtype
    for jacobian in (jax.jacfwd(function)(xi), jax.jacrev(function)(xi)):
        assert jacobian.dtype == dtype
        assert np.isfinite(jacobian).all()


def test_log_of_exp_has_the_identity_as_derivative_at_zero():
    jacobian = jax.jacrev(lambda xi: lie.log(lie.exp(xi)))(jnp.zeros(6))
    assert np.allclose(jacobian, np.eye(6), atol=1e-12)


def test_quaternions_are_xyzw_as_in_scipy():
    rotation = Rotation.random(20, random_state=0)
    t = np.random.default_rng(0).normal(size=(20, 3))
    T = lie.from_quaternion_xyzw(t, 2.5 * rotation.as_quat())
    assert np.allclose(T[:, :3, :3], rotation.as_matrix())
    assert np.allclose(T[:, :3, 3], t)
    assert np.allclose(lie.to_quaternion_xyzw(T), rotation.as_quat(canonical=True))


def test_yaw_of_a_level_pose():
    angles = np.linspace(-3.1, 3.1, 9)
    assert np.allclose(lie.yaw(lie.se2_to_se3(1.0, 2.0, angles, z=0.5)), angles)
    assert np.allclose(lie.se2_to_se3(1.0, 2.0, angles, z=0.5)[:, :3, 3], [1.0, 2.0, 0.5])
