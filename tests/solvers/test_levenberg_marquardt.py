"""The loop on problems with known answers: optimum, how it ends, many at once, derivatives of the solution."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from semloc_jax.errors import SemlocError
from semloc_jax.solvers.dense import DenseProblem
from semloc_jax.solvers.factors import Factors, vector
from semloc_jax.solvers.front import Arrow, solve
from semloc_jax.solvers.gnc import GncConfig, solve_robustly
from semloc_jax.solvers.graph import FactorGraph, Family
from semloc_jax.solvers.implicit import damped_inverse, implicit_step
from semloc_jax.solvers.levenberg_marquardt import SolveConfig, levenberg_marquardt_on_host
from semloc_jax.structs import SolveStatus
from tests.compiling import jit_quickly
from tests.solvers import drives

KEY = np.zeros(1, int)


def banana(x, valley, sqrt_info):
    """Rosenbrock's valley: far steps along a bent floor."""
    return sqrt_info * jnp.stack([x[1] - x[0] ** 2 - valley, 1.0 - x[0]])


def valley_graph(valley=0.0):
    valley, sqrt_info = jnp.asarray([valley]), np.array([[10.0, 1.0]])
    return FactorGraph((Family("x", vector(1.0, 1.0), 1),), (Factors(banana, ("x",), (KEY,), (valley,), sqrt_info),))


@jax.jit
def solved(start, valley=0.0):
    solution = solve(valley_graph(valley), {"x": start[None]}, SolveConfig(1e-9, 200))
    return solution.value["x"][0], solution.status, solution.num_steps, solution.cost


def test_a_bent_valley_is_followed_to_scipys_optimum():
    best = least_squares(lambda x: np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), [-1.2, 1.0], xtol=1e-12)
    x, status, num_steps, cost = solved(jnp.array([-1.2, 1.0]))
    assert status == SolveStatus.CONVERGED and int(num_steps) < 60
    np.testing.assert_allclose(x, best.x, atol=1e-8)
    assert float(cost) < 1e-16


def test_many_starts_at_once_are_one_after_another():
    starts = jnp.asarray(np.random.default_rng(0).normal(size=(16, 2)) * 2)
    together = jax.vmap(solved)(starts)
    for k in (0, 7, 15):
        alone = solved(starts[k])
        assert int(together[2][k]) == int(alone[2])
        np.testing.assert_allclose(together[0][k], alone[0], atol=1e-12)


def test_how_a_solve_ends_is_data():
    graph = valley_graph()
    short = solve(graph, {"x": jnp.array([[-1.2, 1.0]])}, SolveConfig(1e-9, 3))
    assert int(short.status) == SolveStatus.MAX_STEPS and int(short.num_steps) == 3 and not bool(short.converged)
    lost = solve(graph, {"x": jnp.array([[jnp.nan, 1.0]])}, SolveConfig(1e-9, 200))
    assert int(lost.status) == SolveStatus.NOT_FINITE and int(lost.num_steps) == 1
    # A solve that may end when little is left to gain ends sooner and near.
    start = {"x": jnp.array([[0.8, 0.6]])}
    full, early = (solve(graph, start, SolveConfig(1e-9, 200, gain)) for gain in (0.0, 1e-3))
    assert bool(early.converged) and int(early.num_steps) < int(full.num_steps)
    assert float(early.cost) - float(full.cost) < 1e-2


def test_a_short_step_is_taken_without_an_evaluation_where_that_is_asked_for():
    graph, start = valley_graph(), {"x": jnp.array([[-1.2, 1.0]])}
    rules = SolveConfig(tolerance=1e-2, max_steps=60)
    judged, taken = (solve(graph, start, each) for each in (rules, replace(rules, takes_short=True)))
    assert int(taken.num_steps) == int(judged.num_steps) - 1 and bool(taken.converged)
    np.testing.assert_allclose(taken.value["x"], judged.value["x"], atol=1e-12)
    # The cost is what the model foretells: off by the cube of a short step.
    np.testing.assert_allclose(taken.cost, judged.cost, atol=1e-5)
    on_host = levenberg_marquardt_on_host(DenseProblem(graph), start, replace(rules, takes_short=True))
    assert int(on_host.num_steps) == int(taken.num_steps)
    np.testing.assert_allclose(on_host.value["x"], taken.value["x"], atol=1e-12)


def test_derivative_of_a_solution_is_that_of_solving_again():
    """With the valley moved, residuals at the optimum are not zero: the full Hessian counts."""

    def bent(x, valley, sqrt_info):
        return jnp.concatenate([banana(x, valley, sqrt_info), jnp.array([0.5 * (x[0] + x[1] + 3.0)])])

    def graph(valley):
        factors = Factors(bent, ("x",), (KEY,), (jnp.asarray([valley]),), np.array([[2.0, 1.0]]))
        return FactorGraph((Family("x", vector(1.0, 1.0), 1),), (factors,))

    def optimum(valley):
        held = jax.lax.stop_gradient(valley)
        found = solve(graph(held), {"x": jnp.array([[0.2, 0.1]])}, SolveConfig(1e-12, 100))
        x = jax.lax.stop_gradient(found.value["x"][0])

        def force(x, valley):
            return jax.grad(lambda x: graph(valley).cost({"x": x[None]}))(x)

        inverse, least = damped_inverse(jax.jacfwd(force)(x, held), 1e-9)
        return x + implicit_step(inverse, force(x, valley)), least

    derivative, least = jit_quickly(jax.jacrev(optimum, has_aux=True))(0.3)
    # A cost in float64 tells an optimum to 1e-8 at best: a difference over 2e-3 is good to 1e-5.
    compiled = jit_quickly(optimum)
    finite = (compiled(0.3 + 1e-3)[0] - compiled(0.3 - 1e-3)[0]) / 2e-3
    np.testing.assert_allclose(derivative, finite, atol=3e-5)
    assert float(least) > 0.1


def test_false_loops_are_let_go_and_true_ones_kept():
    """Eight of twenty loops lead metres astray; the poses are those of the solve without them."""
    graph, start = drives.laps(60, seed=3, lap=20)
    rng = np.random.default_rng(4)
    poses, true_ends = drives.true_poses(60, lap=20), np.array([(k, k + 20) for k in range(0, 36, 3)])
    false_ends = np.array([(k, k + 30) for k in range(0, 24, 3)])
    T_true = drives.measured_motion(poses, true_ends, rng)
    T_false = drives.measured_motion(poses, false_ends, rng)
    T_false[:, :3, 3] += rng.uniform(2.0, 6.0, size=(8, 3)) * rng.choice([-1, 1], size=(8, 3))
    loops = drives.motions(np.concatenate([true_ends, false_ends]), np.concatenate([T_true, T_false]))
    trusted = graph.factors[:2]
    config = GncConfig(limit_nats=0.5 * 16.8, solve=SolveConfig(1e-6, 30))  # 99 % of chi-square with 6 numbers
    found = solve_robustly(FactorGraph(graph.families, (*trusted, loops)), start, (2,), config)
    assert found.weights[2].tolist() == [1.0] * 12 + [0.0] * 8
    # Weights of one and loops that say nothing: the same program as in the search for the false ones.
    loops = replace(loops, weight=np.ones(20))
    is_true = np.repeat([1.0, 0.0], [12, 8])[:, None, None]
    clean = FactorGraph(graph.families, (*trusted, replace(loops, sqrt_info=is_true * loops.sqrt_info)))
    best = solve(clean, start, SolveConfig(1e-6, 30))
    np.testing.assert_allclose(found.solution.value["pose"], best.value["pose"], atol=1e-5)
    fooled = solve(FactorGraph(graph.families, (*trusted, loops)), start, SolveConfig(1e-6, 30))
    assert np.abs(fooled.value["pose"] - best.value["pose"])[:, :3, 3].max() > 1.0


def test_a_chain_with_loops_is_refused_as_an_arrow():
    graph, start = drives.laps(30, lap=10)
    with pytest.raises(SemlocError, match="binds links 0 and 10"):
        solve(graph, start, structure=Arrow(("pose",)))
