"""Robust losses: penalty and weight belong together, a miss costs `worst`, the root squares back to the penalty."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.residuals.robust import CAUCHY_SCALE, HUBER_SCALE, LOSSES, robust_root

V = jnp.concatenate([jnp.linspace(-1.0, 1.0, 401), jnp.array([1e-9, -1e-7, 3e-6, -1e-4])])


@pytest.fixture(params=LOSSES, ids=str)
def loss(request):
    return LOSSES[request.param]


def test_weight_is_the_slope_of_the_penalty_over_the_residual(loss):
    slope = jax.vmap(jax.grad(loss.rho))(V)
    np.testing.assert_allclose(loss.weight(V) * V, slope, atol=1e-12)


def test_penalty_starts_as_half_the_square_and_grows(loss):
    assert float(loss.rho(jnp.array(0.0))) == 0.0
    assert float(loss.weight(jnp.array(0.0))) == 1.0
    assert float(loss.rho(jnp.array(1e-3))) == pytest.approx(0.5e-6, rel=1e-4)
    assert np.all(np.diff(loss.rho(jnp.linspace(0.0, 1.0, 200))) > 0)
    np.testing.assert_allclose(loss.rho(V), loss.rho(-V), atol=1e-15)


def test_a_miss_costs_worst(loss):
    assert float(loss.rho(jnp.array(1.0))) == pytest.approx(loss.worst, rel=1e-12)


def test_root_squares_to_the_penalty_and_keeps_the_sign(loss):
    root = robust_root(V, loss)
    np.testing.assert_allclose(0.5 * root**2, loss.rho(V), rtol=1e-9, atol=1e-18)
    assert np.array_equal(np.sign(root), np.sign(V))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_slope_of_the_root_is_one_at_zero_and_finite_everywhere(loss, dtype):
    slope = jax.vmap(jax.grad(lambda v: robust_root(v, loss)))(V.astype(dtype))
    assert np.isfinite(slope).all()
    near = np.abs(np.asarray(V)) < 1e-3
    np.testing.assert_allclose(np.asarray(slope)[near], 1.0, atol=1e-3)


def test_kernels_are_those_of_the_books():
    v = np.linspace(-1.0, 1.0, 101)
    huber = np.where(np.abs(v) < HUBER_SCALE, v**2 / 2, HUBER_SCALE * (np.abs(v) - HUBER_SCALE / 2))
    cauchy = CAUCHY_SCALE**2 / 2 * np.log(1 + (v / CAUCHY_SCALE) ** 2)
    tukey = (1 - (1 - v**2) ** 3) / 6
    for name, expected in (("huber", huber), ("cauchy", cauchy), ("tukey", tukey), ("squared", v**2 / 2)):
        np.testing.assert_allclose(LOSSES[name].rho(jnp.asarray(v)), expected, atol=1e-15)


def test_tukey_lets_go_where_the_ramp_ends():
    assert float(LOSSES["tukey"].weight(jnp.array(1.0))) == 0.0
    assert float(jax.grad(LOSSES["tukey"].rho)(jnp.array(-1.0))) == 0.0
