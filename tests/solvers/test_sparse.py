"""Sparse graphs against gtsam and against the dense equations: loops, landmarks, covariances, refusals."""

import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.solvers.dense import DenseProblem
from semloc_jax.solvers.factors import POSE, Factors, vector
from semloc_jax.solvers.front import Dense, Sparse, solve, structured
from semloc_jax.solvers.graph import FactorGraph, Family
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.solvers.sparse import SparseProblem
from tests.solvers import drives

EXACT = SolveConfig(tolerance=1e-7, max_steps=30)
GOING = jnp.asarray(False)


def seen_residual(T_map_base, p_map, p_base, sqrt_info):
    """A landmark seen from a pose."""
    return sqrt_info @ (T_map_base[:3, :3].T @ (p_map - T_map_base[:3, 3]) - p_base)


def with_landmarks(num=40, seed=1):
    """A drive whose every pose sees six of a hundred landmarks; landmarks start half a metre off."""
    rng = np.random.default_rng(seed)
    graph, start = drives.laps(num, seed, lap=16)
    poses = drives.true_poses(num, lap=16)
    landmarks = rng.uniform(-60, 60, size=(100, 3)) * [1, 1, 0.05]
    who, what = np.repeat(np.arange(num), 6), np.concatenate([rng.permutation(100)[:6] for _ in range(num)])
    p_base = np.einsum("nji,nj->ni", poses[who, :3, :3], landmarks[what] - poses[who, :3, 3])
    p_base = p_base + 0.05 * rng.normal(size=p_base.shape)
    sqrt_info = np.tile(np.eye(3) / 0.05, (len(who), 1, 1))
    seen = Factors(seen_residual, ("pose", "landmark"), (who, what), (p_base,), sqrt_info)
    is_seen = np.isin(np.arange(100), what)
    families = (Family("pose", POSE, num), Family("landmark", vector(1.0, 1.0, 1.0), 100))
    free = {"landmark": np.repeat(is_seen[:, None], 3, axis=1)}
    return FactorGraph(families, (*graph.factors, seen), free), start | {
        "landmark": landmarks + 0.5 * rng.normal(size=landmarks.shape)
    }


def test_a_thousand_poses_with_loops_are_those_of_gtsam():
    """Within 1e-6 m and rad of gtsam's optimum, from dead reckoning that is metres off."""
    pytest.importorskip("gtsam")
    graph, start = drives.laps(1000)
    best, _, _ = drives.gtsam_optimum(graph, start)
    solution = solve(graph, start, EXACT, Sparse())
    found = np.asarray(solution.value["pose"])
    off = np.array([rigid.log(np.linalg.inv(theirs) @ ours) for theirs, ours in zip(best, found, strict=True)])
    assert bool(solution.converged)
    assert np.abs(off).max() < 1e-6
    assert np.linalg.norm(start["pose"][:, :3, 3] - best[:, :3, 3], axis=1).max() > 1.0


def test_covariance_of_a_pose_is_that_of_gtsam():
    gtsam = pytest.importorskip("gtsam")
    graph, start = drives.laps(120, lap=40)
    _, factors, best = drives.gtsam_optimum(graph, start)
    problem = SparseProblem(graph)
    solution = solve(problem, start, EXACT)
    mine = problem.covariance(solution.equations, np.arange(6 * 77, 6 * 78))
    order = [3, 4, 5, 0, 1, 2]
    theirs = gtsam.Marginals(factors, best).marginalCovariance(77)[np.ix_(order, order)]
    scale = np.sqrt(np.diag(theirs))
    assert np.allclose(mine / np.outer(scale, scale), theirs / np.outer(scale, scale), atol=1e-3)


@pytest.mark.parametrize("first", [(), ("landmark",)])
def test_landmarks_first_or_not_is_the_dense_solution(first):
    """Poses and landmarks of the dense solve; every step is the dense one, whatever goes first."""
    graph, start = with_landmarks()
    start = {name: jnp.asarray(value) for name, value in start.items()}
    problems = structured(graph, Sparse(first)), structured(graph, Dense())
    steps = [p.step(p.linearise(start, GOING), jnp.asarray(1e-3)) for p in problems]
    for name in start:
        np.testing.assert_allclose(steps[0].tangent[name], steps[1].tangent[name], atol=1e-8)
    assert float(steps[0].change) == pytest.approx(float(steps[1].change), rel=1e-9)
    found, dense = (solve(problem, start, EXACT) for problem in problems)
    assert bool(found.converged) and bool(dense.converged)
    for name in start:
        np.testing.assert_allclose(found.value[name], dense.value[name], atol=1e-7)
    kept = np.arange(240, 246)
    mine = problems[0].covariance(found.equations, kept)
    np.testing.assert_allclose(mine, dense.equations.covariance(kept), atol=1e-10)


def test_what_is_not_seen_stays():
    graph, start = with_landmarks(24)
    found = solve(graph, start, EXACT, Sparse(("landmark",)))
    lost = ~graph.free["landmark"][:, 0]
    assert lost.any()
    np.testing.assert_array_equal(np.asarray(found.value["landmark"])[lost], start["landmark"][lost])


def test_a_graph_that_hangs_free_stays_finite():
    """Without an anchor the matrix is singular: the solve still ends, with finite poses."""
    graph, start = drives.laps(30, lap=10)
    loose = FactorGraph(graph.families, graph.factors[1:])
    found = solve(loose, start, SolveConfig(1e-6, 20), Sparse())
    assert np.isfinite(np.asarray(found.value["pose"])).all()
    assert float(found.cost) < float(DenseProblem(loose).linearise(start, GOING).cost)


def test_refusals_say_what_was_expected():
    graph, _ = with_landmarks(24)
    with pytest.raises(SemlocError, match="two variables that go first"):
        SparseProblem(graph, ("pose",))
    same = drives.motions(np.array([[3, 3]]), np.eye(4)[None])
    with pytest.raises(SemlocError, match="binds one variable twice"):
        SparseProblem(FactorGraph(graph.families, (same,)))
