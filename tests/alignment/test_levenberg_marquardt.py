"""The fused solver: its chart, and its optimum against scipy's on the same residual."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from semloc_jax.alignment.pose import AlignConfig, level_problem, visible_views
from semloc_jax.alignment.problem import POSE_DAMPING, pose_of, prior_offset, residual
from semloc_jax.geometry import lie
from semloc_jax.residuals.chart import right_jacobian
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.solvers.optimistix_loop import levenberg_marquardt
from tests.contracts.ground_scene import scene

STARTS = np.array([[0.25, -0.15, 0.02, 0.004, -0.003, 0.02], [-0.3, 0.1, 0.0, -0.003, 0.002, -0.015]])


@eqx.filter_jit
def solve(problem, atol):
    return levenberg_marquardt(problem, jnp.zeros(6), SolveConfig(atol, 200, damping=POSE_DAMPING))


compiled_residual = eqx.filter_jit(residual)
compiled_jacobian = eqx.filter_jit(jax.jacfwd(residual))


def problem_of(name, start, level, loss="tukey"):
    world = scene(name)
    T_start = world.moved(start)
    views = visible_views(T_start, world.evidence, 2.0)
    prior = world.prior([0.05, 0.02, 0.0, 0.001, 0.0, -0.004])
    return level_problem(T_start, views, level, world.evidence, prior, AlignConfig(loss=loss))


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize(("name", "start"), [("radtan", 0), ("radtan", 1), ("mixed", 0)])
def test_optimum_is_scipys(name, start, level):
    """Within 1e-4 of the prior's sigmas (0.1 mm, 0.5 urad) of scipy's trust-region optimum of the same residual."""
    problem = problem_of(name, STARTS[start], level)
    ours = solve(problem, 1e-8)
    theirs = least_squares(
        lambda y: np.asarray(compiled_residual(jnp.asarray(y), problem)),
        np.zeros(6),
        jac=lambda y: np.asarray(compiled_jacobian(jnp.asarray(y), problem)),
        xtol=1e-12,
        ftol=1e-14,
        gtol=1e-12,
        max_nfev=400,
    )
    cost = 0.5 * float(jnp.sum(compiled_residual(ours.value, problem) ** 2))
    assert cost <= theirs.cost + 1e-6
    assert np.abs(np.asarray(ours.value) - theirs.x).max() < 1e-4


@pytest.mark.parametrize("angle_rad", [0.0, 1e-6, 1e-3, 0.05, 0.3])
def test_right_jacobian_is_the_derivative_of_the_exponential(angle_rad):
    """log(exp(xi)^-1 exp(xi + d)) = J_r(xi) d for small d, by central differences."""
    rng = np.random.default_rng(int(angle_rad * 1e6))
    axis = rng.normal(size=3)
    xi = np.concatenate([rng.normal(size=3) * 2.0, angle_rad * axis / np.linalg.norm(axis)])
    step = 1e-5
    numeric = np.stack(
        [
            (lie.log(lie.inverse(lie.exp(xi)) @ lie.exp(xi + s)) - lie.log(lie.inverse(lie.exp(xi)) @ lie.exp(xi - s)))
            / (2 * step)
            for s in step * np.eye(6)
        ],
        axis=-1,
    )
    np.testing.assert_allclose(right_jacobian(jnp.asarray(xi)), numeric, atol=2e-7)


def test_the_chart_scales_by_the_prior_and_locks_directions():
    problem = problem_of("radtan", STARTS[0], 1)
    y = jnp.array([1.0, -0.5, 0.3, 0.2, -0.4, 0.6])
    moved = lie.log(lie.inverse(problem.T_start) @ pose_of(y, problem))
    np.testing.assert_allclose(moved, problem.sigma * y, atol=1e-9)
    # The centre of the prior is where the offset says.
    centre = pose_of(prior_offset(problem), problem)
    np.testing.assert_allclose(lie.log(lie.inverse(problem.T_start) @ centre), problem.xi_prior, atol=1e-9)
    locked = eqx.tree_at(lambda p: p.sigma, problem, problem.sigma.at[2].set(0.0))
    assert float(prior_offset(locked)[2]) == 0.0
    np.testing.assert_allclose(pose_of(y, locked), pose_of(y.at[2].set(7.0), locked), atol=0)


def test_a_looser_tolerance_ends_sooner_and_near():
    problem = problem_of("radtan", STARTS[0], 1)
    tight, loose = solve(problem, 1e-8), solve(problem, 2e-3)
    assert int(loose.num_steps) < int(tight.num_steps)
    assert np.abs(np.asarray(loose.value - tight.value)).max() < 0.02
