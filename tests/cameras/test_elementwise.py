"""The functions that the camera models are made of, against numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.cameras.elementwise import MIN_SLOPE, angle_of, at_least, at_most, usable_radius


def test_angle_in_float32_is_good_to_a_ten_thousandth_of_a_pixel():
    direction = np.random.default_rng(0).normal(size=(2, 100_000)).astype(np.float32)
    angle = angle_of(*direction)
    assert angle.dtype == np.float32
    exact = np.arctan2(*direction.astype(np.float64))
    # 4e-7 rad are 4e-4 px at a focal length of 1000 px; half of it is the step of float32 at pi.
    assert np.abs(np.asarray(angle) - exact).max() < 4e-7
    front = np.abs(exact) < np.pi / 2
    assert np.abs(np.asarray(angle) - exact)[front].max() < 2e-7


def test_angle_on_the_axes():
    y = np.array([0.0, 1.0, -1.0, 0.0, 1.0, 0.0], dtype=np.float32)
    x = np.array([1.0, 0.0, 0.0, -1.0, -1.0, 0.0], dtype=np.float32)
    assert np.allclose(angle_of(y, x), np.arctan2(y, x), atol=2e-7)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_angle_has_the_derivative_of_atan2_and_zero_at_the_origin(dtype):
    y, x = np.random.default_rng(0).normal(size=(2, 50)).astype(dtype)
    gradient = jax.vmap(jax.grad(angle_of, argnums=(0, 1)))(y, x)
    assert np.allclose(gradient, [x / (x**2 + y**2), -y / (x**2 + y**2)], rtol=1e-5)
    assert jax.grad(angle_of, argnums=(0, 1))(jnp.zeros((), dtype), jnp.zeros((), dtype)) == (0.0, 0.0)


def test_clamps_have_a_derivative_on_one_side_only():
    values = jnp.array([-1.0, 2.0, 5.0])
    assert np.array_equal(at_least(values, 2.0), [2.0, 2.0, 5.0])
    assert np.array_equal(at_most(values, 2.0), [-1.0, 2.0, 2.0])
    assert np.array_equal(jax.vmap(jax.grad(lambda v: at_least(v, 2.0)))(values), [0.0, 0.0, 1.0])
    assert np.array_equal(jax.vmap(jax.grad(lambda v: at_most(v, 2.0)))(values), [1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    "coefficients",
    [(1.0, -0.3, 0.02, 0.0), (1.0, -0.118, 0.042, 0.0), (1.0, -0.5, 0.3, -0.1), (1.0, 0.1, -0.05), (1.0, 0.0, 0.0)],
)
def test_usable_radius_ends_where_the_polynomial_bends(coefficients):
    radius = np.linspace(0.0, 10.0, 2_000_001)
    value = radius * np.polynomial.polynomial.polyval(radius**2, coefficients)
    flat = np.flatnonzero(np.gradient(value, radius) < MIN_SLOPE)
    expected = radius[flat[0]] if flat.size else 10.0
    assert usable_radius(coefficients, 10.0) == pytest.approx(expected, abs=1e-4)
    assert usable_radius(coefficients, 0.3) == 0.3
