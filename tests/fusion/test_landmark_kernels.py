"""The kernels for landmarks of a window give the numbers of pure JAX: views, road, robust weights, elimination."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax import native
from semloc_jax.fusion import inertial_sights
from semloc_jax.fusion.inertial_graph import WindowProblem
from semloc_jax.fusion.inertial_window import InertialWindow
from semloc_jax.geometry import rigid
from semloc_jax.solvers import schur
from tests.fusion.inertial_world import World
from tests.fusion.test_inertial_window import begun

pytestmark = pytest.mark.skipif(not native.is_available(), reason=f"native kernels {native.status().text}")


def problem_away_from_its_first_estimates() -> tuple:
    """Every third point on the road; states and landmarks so far off that weights differ from 1."""
    window, *_ = begun(3, 8, world=World(seed=3, num_slots=40))
    window.pool.value[:, :2] += 0.01
    rows, problem, values = InertialWindow._problem(window)
    rng = np.random.default_rng(0)
    moved = values | {"pose": values["pose"] @ rigid.exp(rng.normal(size=(6, 6)) * [0.05] * 6)}
    moved |= {"height": values["height"] + 0.02, "bend": values["bend"] + 3e-4, "landmark": values["landmark"] + 0.002}
    assert len(rows) > 20 and (problem.views.sqrt_info == 0).any(), "some views are not there"
    views = problem.views._replace(on_road=np.where(np.arange(40) % 3 == 0, 20.0, 0.0))
    return WindowProblem(problem.factors, views, problem.prior, problem.threshold), values, moved


def test_what_landmarks_say_is_what_jax_says():
    problem, at, value = problem_away_from_its_first_estimates()
    with jax.enable_x64(True):
        at, value = (jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), v) for v in (at, value))
        found = inertial_sights.seen_equations(problem.views, value, at, problem.threshold)
        expected = jax.jit(inertial_sights._by_jax, static_argnums=3)(problem.views, value, at, problem.threshold)
    for name, one, other in zip(found._fields, found, expected, strict=True):
        assert np.abs(other).max() > 0.0 and one.shape == other.shape
        np.testing.assert_allclose(one, other, atol=1e-10 * np.abs(other).max(), err_msg=name)


def test_what_they_leave_is_what_jax_leaves():
    rng = np.random.default_rng(1)
    across = rng.normal(size=(9, 14, 3)) * (rng.random((9, 14, 1)) < 0.5)
    half = rng.normal(size=(9, 3, 3))
    block, gradient = half @ half.swapaxes(1, 2) + np.eye(3), rng.normal(size=(9, 3))
    with jax.enable_x64(True):
        inverse = schur._inverses(jnp.asarray(block))
        np.testing.assert_allclose(inverse, np.linalg.inv(block), atol=1e-12)
        S, g = schur._eliminated(jnp.asarray(across), inverse, jnp.asarray(gradient))
    gain = across @ np.linalg.inv(block)
    np.testing.assert_allclose(S, np.einsum("lpk,lqk->pq", gain, across), atol=1e-11)
    np.testing.assert_allclose(g, np.einsum("lpk,lk->p", gain, gradient), atol=1e-11)
