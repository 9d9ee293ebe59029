"""Sparse graphs against gtsam and against the dense equations: loops, landmarks, covariances, refusals.

All graphs of poses have one shape, and all with landmarks another, so that few programs are compiled.
"""

import time
from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.solvers.factors import POSE, Factors, vector
from semloc_jax.solvers.front import Dense, Sparse, solve, structured
from semloc_jax.solvers.graph import FactorGraph, Family
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.solvers.sparse import SparseProblem
from tests.compiling import jit_quickly
from tests.solvers import drives

EXACT = SolveConfig(tolerance=1e-7, max_steps=30)
GOING = jnp.asarray(False)
DAMPING = jnp.asarray(1e-3)


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


@cache
def thousand_poses():
    """A graph of a thousand poses with loops, dead reckoning, the problem and its solution."""
    graph, start = drives.laps(1000, every=7)  # 107 loops
    problem = SparseProblem(graph)
    return graph, start, problem, solve(problem, start, EXACT)


def test_a_thousand_poses_with_loops_are_those_of_gtsam():
    """Within 1e-6 m and rad of gtsam's optimum, from dead reckoning that is metres off; prints the times of both."""
    pytest.importorskip("gtsam")
    graph, start, _, solution = thousand_poses()
    best, _, _, theirs_s = drives.gtsam_optimum(graph, start)
    found = np.asarray(solution.value["pose"])
    off = np.array([rigid.log(np.linalg.inv(theirs) @ ours) for theirs, ours in zip(best, found, strict=True)])
    assert bool(solution.converged)
    assert np.abs(off).max() < 1e-6
    began_s = time.process_time()
    solve(SparseProblem(graph), start, EXACT)
    ours_s = time.process_time() - began_s
    num_loops = len(graph.factors[-1].keys[0])
    print(f"{num_loops} loops, {np.abs(off).max():.0e} apart; {ours_s:.2f} CPU s, gtsam {theirs_s:.2f}", end=" ")
    assert np.linalg.norm(start["pose"][:, :3, 3] - best[:, :3, 3], axis=1).max() > 1.0


def test_covariance_of_a_pose_is_that_of_gtsam():
    gtsam = pytest.importorskip("gtsam")
    graph, start, problem, solution = thousand_poses()
    _, factors, best, _ = drives.gtsam_optimum(graph, start)
    mine = problem.covariance(solution.equations, np.arange(6 * 77, 6 * 78))
    order = [3, 4, 5, 0, 1, 2]
    theirs = gtsam.Marginals(factors, best).marginalCovariance(77)[np.ix_(order, order)]
    scale = np.sqrt(np.diag(theirs))
    assert np.allclose(mine / np.outer(scale, scale), theirs / np.outer(scale, scale), atol=1e-3)


@jit_quickly
def dense_way(graph, start):
    """One step of the dense problem from the start, and its solution."""
    problem = structured(graph, Dense())
    return problem.step(problem.linearise(start, GOING), DAMPING), solve(problem, start, EXACT)


@pytest.mark.parametrize("first", [pytest.param((), marks=pytest.mark.slow), ("landmark",)])
def test_landmarks_first_or_not_is_the_dense_solution(first):
    """Poses and landmarks of the dense solve; every step is the dense one, whatever goes first."""
    graph, start = with_landmarks()
    start = {name: jnp.asarray(value) for name, value in start.items()}
    problem = structured(graph, Sparse(first))
    step, (step_of_dense, dense) = problem.step(problem.linearise(start, GOING), DAMPING), dense_way(graph, start)
    for name in start:
        np.testing.assert_allclose(step.tangent[name], step_of_dense.tangent[name], atol=1e-8)
    assert float(step.change) == pytest.approx(float(step_of_dense.change), rel=1e-9)
    found = solve(problem, start, EXACT)
    assert bool(found.converged) and bool(dense.converged)
    for name in start:
        np.testing.assert_allclose(found.value[name], dense.value[name], atol=1e-7)
    kept = np.arange(240, 246)
    theirs = jit_quickly(lambda equations: equations.covariance(kept))(dense.equations)
    np.testing.assert_allclose(problem.covariance(found.equations, kept), theirs, atol=1e-10)


def test_what_is_not_seen_stays():
    graph, start = with_landmarks()
    found = solve(graph, start, EXACT, Sparse(("landmark",)))
    lost = ~graph.free["landmark"][:, 0]
    assert lost.any()
    np.testing.assert_array_equal(np.asarray(found.value["landmark"])[lost], start["landmark"][lost])


def test_a_graph_that_hangs_free_stays_finite():
    """Without an anchor the matrix is singular: the solve still ends, with finite poses."""
    graph, start, _, _ = thousand_poses()
    anchor = graph.factors[0]
    loose = replace(graph, factors=(replace(anchor, sqrt_info=0 * anchor.sqrt_info), *graph.factors[1:]))
    found = solve(loose, start, SolveConfig(1e-6, 20), Sparse())
    assert np.isfinite(np.asarray(found.value["pose"])).all()
    assert float(found.cost) < float(jit_quickly(lambda graph, start: graph.cost(start))(loose, start))


def test_refusals_say_what_was_expected():
    graph, _ = with_landmarks(24)
    with pytest.raises(SemlocError, match="two variables that go first"):
        SparseProblem(graph, ("pose",))
    same = drives.motions(np.array([[3, 3]]), np.eye(4)[None])
    with pytest.raises(SemlocError, match="binds one variable twice"):
        SparseProblem(FactorGraph(graph.families, (same,)))
