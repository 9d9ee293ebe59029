"""Robust kernels: penalty and weight belong together, a miss costs `worst`, the root squares back to the penalty."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.residuals.robust import CAUCHY_SCALE, HUBER_SCALE, KERNELS, robust_root

V = jnp.concatenate([jnp.linspace(-1.0, 1.0, 401), jnp.array([1e-9, -1e-7, 3e-6, -1e-4])])


@pytest.fixture(params=KERNELS, ids=str)
def kernel(request):
    return KERNELS[request.param]


def test_weight_is_the_slope_of_the_penalty_over_the_residual(kernel):
    slope = jax.vmap(jax.grad(kernel.rho))(V)
    np.testing.assert_allclose(kernel.weight(V) * V, slope, atol=1e-12)


def test_penalty_starts_as_half_the_square_and_grows(kernel):
    assert float(kernel.rho(jnp.array(0.0))) == 0.0
    assert float(kernel.weight(jnp.array(0.0))) == 1.0
    assert float(kernel.rho(jnp.array(1e-3))) == pytest.approx(0.5e-6, rel=1e-4)
    assert np.all(np.diff(kernel.rho(jnp.linspace(0.0, 1.0, 200))) > 0)
    np.testing.assert_allclose(kernel.rho(V), kernel.rho(-V), atol=1e-15)


def test_a_miss_costs_worst(kernel):
    assert float(kernel.rho(jnp.array(1.0))) == pytest.approx(kernel.worst, rel=1e-12)


def test_root_squares_to_the_penalty_and_keeps_the_sign(kernel):
    root = robust_root(V, kernel)
    np.testing.assert_allclose(0.5 * root**2, kernel.rho(V), rtol=1e-9, atol=1e-18)
    assert np.array_equal(np.sign(root), np.sign(V))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_slope_of_the_root_is_one_at_zero_and_finite_everywhere(kernel, dtype):
    slope = jax.vmap(jax.grad(lambda v: robust_root(v, kernel)))(V.astype(dtype))
    assert np.isfinite(slope).all()
    near = np.abs(np.asarray(V)) < 1e-3
    np.testing.assert_allclose(np.asarray(slope)[near], 1.0, atol=1e-3)


def test_kernels_are_those_of_the_books():
    v = np.linspace(-1.0, 1.0, 101)
    huber = np.where(np.abs(v) < HUBER_SCALE, v**2 / 2, HUBER_SCALE * (np.abs(v) - HUBER_SCALE / 2))
    cauchy = CAUCHY_SCALE**2 / 2 * np.log(1 + (v / CAUCHY_SCALE) ** 2)
    tukey = (1 - (1 - v**2) ** 3) / 6
    for name, expected in (("huber", huber), ("cauchy", cauchy), ("tukey", tukey), ("squared", v**2 / 2)):
        np.testing.assert_allclose(KERNELS[name].rho(jnp.asarray(v)), expected, atol=1e-15)


def test_tukey_lets_go_where_the_ramp_ends():
    assert float(KERNELS["tukey"].weight(jnp.array(1.0))) == 0.0
    assert float(jax.grad(KERNELS["tukey"].rho)(jnp.array(-1.0))) == 0.0
