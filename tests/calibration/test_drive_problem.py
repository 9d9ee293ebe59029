"""The batch solve of poses and calibration: derivatives, elimination, recovery on a scene known in closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.calibration.drive_problem import solve_calibration
from semloc_jax.geometry import lie, rigid
from semloc_jax.residuals.alignment import Usable
from semloc_jax.residuals.road_contact import road_linearised, road_residual
from semloc_jax.solvers import arrow
from tests.compiling import jit_quickly
from tests.contracts.calibration_scene import BIAS, OFFSET, SCALE, build

TURNS = (0.25, 0.3, 0.2, -0.25, -0.3, -0.2, 0.1)
USABLE = Usable(jnp.ones((1, 75, 120), bool), 2)


def moved(problem, state, seed, pose_scale, shared_scale):
    """The state after a seeded random step, shared unknowns in sigmas."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(len(state.T_local_base), 6)) * pose_scale
    shared = rng.normal(size=len(problem.sigma)) * shared_scale
    return jit_quickly(lambda *given: given[0].retract(*given[1:]))(problem, state, (poses, shared))


@eqx.filter_jit
def linearised(problem, state):
    """Normal equations, compiled."""
    return problem.linearise(state, jnp.asarray(False))


dense_equations = jit_quickly(lambda equations: equations.dense())
minimum_and_reduced = jit_quickly(lambda equations: (arrow.minimum(equations), arrow.reduced(equations)))


@pytest.fixture(scope="module")
def lens_scene():
    """Five frames of a radtan camera whose focal length and first coefficient are unknown, off the truth."""
    problem, state = build("radtan", (0.05, 0.1, -0.02, 0.0), (("fx", "k1"),), 150)
    return problem, moved(problem, state, 0, np.array([0.05, 0.05, 0.02, 0.003, 0.003, 0.005]), 0.2)


def test_gradient_is_that_of_the_residuals_by_finite_differences(lens_scene):
    problem, state = lens_scene
    num, size = len(state.T_local_base), len(problem.sigma)

    @jit_quickly
    def cost(x):
        r = problem.residuals(problem.retract(state, (x[: 6 * num].reshape(num, 6), x[6 * num :])))
        return 0.5 * r @ r

    equations = linearised(problem, state)
    _, gradient = dense_equations(equations)
    steps = 1e-6 * np.eye(6 * num + size)
    numeric = np.array([(cost(d) - cost(-d)) / 2e-6 for d in steps])
    assert float(equations.cost) == pytest.approx(float(cost(steps[0] * 0)), rel=1e-12)
    np.testing.assert_allclose(gradient, numeric, atol=2e-5 * np.abs(numeric).max())


def test_eliminating_the_chain_gives_the_dense_step(lens_scene):
    problem, state = lens_scene
    equations = linearised(problem, state)
    H, g = dense_equations(equations)
    dense = -np.linalg.solve(H, g)
    (poses, shared), reduced = minimum_and_reduced(equations)
    np.testing.assert_allclose(np.concatenate([poses.ravel(), shared]), dense, atol=1e-10)
    size = len(problem.sigma)
    covariance = np.linalg.inv(H)[-size:, -size:]
    np.testing.assert_allclose(np.linalg.inv(reduced[0]), covariance, atol=1e-10)


@pytest.mark.slow
def test_a_turned_mount_odometer_scale_and_offset_are_found():
    problem, true = build("radtan", TURNS, num=250)
    turn = np.radians([1.0, -1.0, 1.5])
    start = eqx.tree_at(
        lambda s: (s.T_base_cam, s.common),
        true,
        (lie.compose(true.T_base_cam, lie.exp(jnp.asarray([0.0, 0.0, 0.0, *turn]))), problem.common_prior),
    )
    # The priors say what a user says: the mount as it is given, the wheels without a scale.
    problem = eqx.tree_at(lambda p: p.T_prior, problem, start.T_base_cam)
    # Exact pictures, road and wheels may count for more than real ones: the priors, which are wrong, then hardly pull.
    problem = eqx.tree_at(
        lambda p: (p.gain, p.anchors.road_sqrt_info, p.motion.sqrt_info),
        problem,
        (100 * problem.gain, 10 * problem.anchors.road_sqrt_info, 5 * problem.motion.sqrt_info),
    )
    solution = solve_calibration(problem, start, USABLE, tolerance=1e-3, max_steps=60)
    found = solution.state
    off = np.asarray(lie.log(lie.compose(lie.inverse(true.T_base_cam[0]), found.T_base_cam[0])))
    assert bool(solution.converged)
    assert np.degrees(np.abs(off[3:])).max() < 0.05
    assert abs(float(found.common[0]) - SCALE) < 5e-4
    assert abs(float(found.common[1]) - BIAS) < 2e-4
    # The fixes of all frames together weigh 8 x 0.3^2 / m^2, the prior, which says none, 1 / (3 m)^2.
    fixes = len(TURNS) + 1
    np.testing.assert_allclose(found.common[2:4], OFFSET / (1 + 1 / (fixes * 0.3**2 * 3.0**2)), atol=0.005)


def test_a_locked_unknown_stays(lens_scene):
    problem, state = lens_scene
    problem = eqx.tree_at(lambda p: p.sigma, problem, problem.sigma.at[:6].set(0.0))
    (poses, shared), _ = minimum_and_reduced(linearised(problem, state))
    assert np.abs(shared[:6]).max() == 0.0
    assert np.abs(poses).max() > 0.0


def test_road_contact_by_finite_differences_and_by_hand():
    tilt = np.array([0.0, 0.0, 0.0, 0.02, -0.03, 0.7])
    T = rigid.exp(np.array([5.0, 2.0, 1.0, 0.0, 0.0, 0.0])) @ rigid.exp(tilt)
    point, normal, ones = np.array([5.0, 2.0, 0.9]), np.array([0.0, 0.0, 1.0]), np.ones(3)
    stance = np.array([0.01, 0.001, 0.002])

    @jit_quickly
    def by_both(T, *others):
        numeric = jax.jacfwd(lambda xi: road_residual(T @ lie.exp(xi), *others))(jnp.zeros(6))
        return road_linearised(T, *others), numeric

    (r, J, J_stance), numeric = by_both(T, stance, point, normal, ones)
    assert float(r[0]) == pytest.approx(0.09, abs=1e-12)
    np.testing.assert_allclose(J, numeric, atol=1e-12)
    np.testing.assert_allclose(J_stance, -np.eye(3))
    level = rigid.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.02, 0.0]))
    pitched = jit_quickly(road_residual)(level, 0 * stance, 0 * point, normal, ones)
    np.testing.assert_allclose(pitched, [0.0, 0.0, 0.02], atol=1e-5)
