"""Poses over time against gtsam and scipy: optimum, joint covariance, wrong edges, derivatives, marginals, chain."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from semloc_jax.fusion.pose_factors import (
    calibration_of,
    fixes,
    measured_poses,
    odometry,
    pose_graph,
    prior,
    values_of,
)
from semloc_jax.geometry import rigid
from semloc_jax.residuals.motion import cauchy, cauchy_cost
from semloc_jax.solvers.dense import DenseEquations, DenseProblem, marginal
from semloc_jax.solvers.front import Arrow, Dense, solve
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from tests.compiling import jit_quickly

NUM = 5
EXACT = SolveConfig(tolerance=1e-7, max_steps=30)
NO_KERNEL = 1e6
POSE_SIGMA = np.array([0.10, 0.05, 0.05, 0.01, 0.01, 0.005])
EDGE_SIGMA = np.array([0.02, 0.01, 0.01, 0.002, 0.002, 0.001])
NOMINAL = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
UNKNOWNS = 6 * NUM + 5


def true_poses():
    step = rigid.exp(np.array([2.0, 0.1, 0.0, 0.01, -0.02, 0.3]))
    poses = [rigid.exp(np.array([50.0, -30.0, 3.0, 0.1, -0.1, 2.0]))]
    for _ in range(NUM - 1):
        poses.append(poses[-1] @ step)
    return poses


def make(seed=0, loop=None, calibrated=False, num_used=NUM, edges_robust=False):
    """A noisy chain with a measured pose at each state and one more edge from the first to the last state."""
    rng = np.random.default_rng(seed)
    poses = true_poses()
    start, end = np.array([*range(NUM - 1), 0]), np.array([*range(1, NUM), NUM - 1])
    ends = list(zip(start, end, strict=True))
    edges = [rigid.inverse(poses[a]) @ poses[b] @ rigid.exp(rng.normal(size=6) * EDGE_SIGMA) for a, b in ends]
    if loop is not None:
        edges[-1] = edges[-1] @ loop
    measured = np.array([T @ rigid.exp(rng.normal(size=6) * POSE_SIGMA) for T in poses])
    jacobian = np.zeros((NUM, 6, 3))
    if calibrated:
        jacobian[:-1, 0, 0], jacobian[:-1, 5, 1], jacobian[:-1, 1, 2] = 2.0, -0.2, 2.0
    p_fix = np.array([T[:2, 3] for T in poses]) + [2.0, -1.0] + 0.3 * rng.normal(size=(NUM, 2))
    T_prior = poses[0] @ rigid.exp(rng.normal(size=6) * POSE_SIGMA)
    used, edge_used = np.arange(NUM) < num_used, end < num_used
    prior_sqrt_info = np.diag([*np.zeros(6), 50.0, 300.0, 200.0, 0.3, 0.3]) + 0.1 * np.eye(11, k=2) * calibrated
    edge_info = np.diag(1 / EDGE_SIGMA) * edge_used[:, None, None]
    moved = odometry(start, end, np.array(edges), jacobian, np.tile([1.0, 0.0, 0.0], (NUM, 1)), edge_info)
    factors = (
        measured_poses(measured, np.diag(1 / POSE_SIGMA) * used[:, None, None], NO_KERNEL),
        replace(moved, robust=cauchy(3.0)) if edges_robust else moved,
        fixes(p_fix, np.tile([0.5, 0.2, 1.5], (NUM, 1)), np.full((NUM, 2), 2.0 * calibrated), NO_KERNEL),
        prior(T_prior, NOMINAL, prior_sqrt_info),
    )
    return pose_graph(used, factors), values_of(measured, NOMINAL)


@jit_quickly
def solved(graph, values):
    """The dense solution and the joint covariance of all unknowns; all graphs but one share this program."""
    solution = solve(graph, values, EXACT, Dense())
    return solution, solution.equations.covariance()


@jit_quickly
def solved_as_arrow(graph, values):
    """The same by an arrow; its covariance is that of the third pose and what is shared."""
    solution = solve(graph, values, EXACT, Arrow(("pose",)))
    return solution, solution.equations.covariance(2)


def moved(x, graph, values):
    steps = {"pose": x[:-5].reshape(-1, 6), "odometer": x[None, -5:-2], "gnss": x[None, -2:]}
    return graph.retract(values, steps)


@jit_quickly
def residuals_at(x, graph, values):
    there = moved(x, graph, values)
    return jnp.concatenate([factors.residuals(there).ravel() for factors in graph.factors])


def test_optimum_and_covariance_are_those_of_gtsam():
    gtsam = pytest.importorskip("gtsam")
    graph, values = make()

    # gtsam's tangent of a pose is (rotation, translation).
    def noise(sigma):
        return gtsam.noiseModel.Diagonal.Sigmas(np.concatenate([sigma[3:], sigma[:3]]))

    factors, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, T in enumerate(values["pose"]):
        factors.add(gtsam.PriorFactorPose3(k, gtsam.Pose3(T), noise(POSE_SIGMA)))
        start.insert(k, gtsam.Pose3(T))
    edges = graph.factors[1]
    for a, b, T in zip(edges.keys[0], edges.keys[1], edges.data[0], strict=True):
        factors.add(gtsam.BetweenFactorPose3(int(a), int(b), gtsam.Pose3(T), noise(EDGE_SIGMA)))
    best = gtsam.LevenbergMarquardtOptimizer(factors, start).optimize()
    solution, covariance = jax.tree.map(np.asarray, solved(graph, values))
    marginals = gtsam.Marginals(factors, best)
    order = [3, 4, 5, 0, 1, 2]
    for k in range(NUM):
        off = rigid.log(rigid.inverse(best.atPose3(k).matrix()) @ np.asarray(solution.value["pose"][k]))
        assert np.linalg.norm(off[:3]) < 1e-5 and np.linalg.norm(off[3:]) < 1e-6
        mine = covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6]
        theirs = marginals.marginalCovariance(k)[np.ix_(order, order)]
        assert np.allclose(np.sqrt(np.diag(mine)), np.sqrt(np.diag(theirs)), rtol=1e-3)
        assert np.allclose(mine, theirs, atol=2e-3 * np.sqrt(np.outer(np.diag(theirs), np.diag(theirs))))


def test_calibration_offset_and_fixes_against_scipy():
    graph, values = make(3, calibrated=True)
    solution, _ = solved(graph, values)
    best = least_squares(lambda x: np.asarray(residuals_at(x, graph, values)), np.zeros(UNKNOWNS), x_scale="jac")
    there = jit_quickly(moved)(best.x, graph, values)
    assert bool(solution.converged)
    assert float(solution.cost) == pytest.approx(best.cost, rel=1e-6)
    calibration, expected = jit_quickly(lambda *both: [calibration_of(one) for one in both])(solution.value, there)
    assert np.allclose(calibration, expected, atol=1e-4)
    assert np.allclose(solution.value["pose"], there["pose"], atol=1e-4)


def test_normal_equations_are_the_derivatives_of_the_residuals():
    graph, values = make(4, calibrated=True)
    x0 = np.zeros(UNKNOWNS)

    def residuals(x):
        return np.asarray(residuals_at(x, graph, values))

    step = 1e-6
    J = np.array([(residuals(x0 + step * d) - residuals(x0 - step * d)) / (2 * step) for d in np.eye(len(x0))]).T
    equations = jit_quickly(lambda graph, values: DenseProblem(graph).linearise(values, jnp.asarray(False)))(
        graph, values
    )
    scale = np.sqrt(np.diag(J.T @ J))
    assert np.allclose(equations.information / np.outer(scale, scale), (J.T @ J) / np.outer(scale, scale), atol=1e-6)
    assert np.allclose(equations.gradient / scale, J.T @ residuals(x0) / scale, atol=1e-5)
    assert float(equations.cost) == pytest.approx(0.5 * np.sum(residuals(x0) ** 2), rel=1e-9)


def test_a_wrong_edge_is_outvoted_when_edges_are_robust():
    """An edge that is 1.5 m off: 3 cm with the robust function, decimetres without."""
    clean, _ = solved(*make(5))
    errors = []
    for is_robust in (True, False):
        graph, values = make(5, loop=rigid.exp(np.array([1.5, 0, 0, 0, 0, 0])), edges_robust=is_robust)
        off = (np.asarray(solved(graph, values)[0].value["pose"]) - np.asarray(clean.value["pose"]))[:, :3, 3]
        errors.append(np.max(np.linalg.norm(off, axis=1)))
    assert errors[0] < 0.03 and errors[1] > 0.2


def test_a_chain_solved_as_an_arrow_is_the_dense_solution():
    """The same poses, calibration and covariance when every pose is eliminated into the next."""
    graph, values = make(8, calibrated=True)
    edges = graph.factors[1]
    chain = replace(
        edges,
        keys=tuple(key[:-1] for key in edges.keys),
        data=tuple(part[:-1] for part in edges.data),
        sqrt_info=edges.sqrt_info[:-1],
    )
    # An arrow may not hold the edge from the first to the last pose; in the dense graph it says nothing.
    says_nothing = replace(edges, sqrt_info=edges.sqrt_info * (np.arange(NUM) < NUM - 1)[:, None, None])
    (dense, covariance), (arrow, of_third) = (
        way(replace(graph, factors=(graph.factors[0], family, *graph.factors[2:])), values)
        for way, family in ((solved, says_nothing), (solved_as_arrow, chain))
    )
    assert bool(arrow.converged)
    assert float(arrow.cost) == pytest.approx(float(dense.cost), rel=1e-12)
    for name in values:
        np.testing.assert_allclose(arrow.value[name], dense.value[name], atol=1e-8)
    wanted = np.r_[12:18, 30:35]
    np.testing.assert_allclose(of_third, np.asarray(covariance)[np.ix_(wanted, wanted)], atol=1e-10)


def test_robust_cost_is_quadratic_near_zero_and_logarithmic_far_away():
    for size in (0.01, 2.0, 40.0):
        r = size * jnp.array([0.6, -0.8, 0.0])
        cost, weight = cauchy_cost(r, 3.0)
        assert float(cost) == pytest.approx(4.5 * np.log1p((size / 3.0) ** 2), rel=1e-6)
        gradient = jax.grad(lambda q: cauchy_cost(q, 3.0)[0])(r)
        assert np.allclose(gradient, weight**2 * r, atol=1e-9)


def test_marginal_is_the_covariance_of_what_is_kept():
    rng = np.random.default_rng(6)
    A, b = rng.normal(size=(20, 7)), rng.normal(size=20)
    equations = DenseEquations(jnp.asarray(0.5 * b @ b), jnp.asarray(A.T @ b), jnp.asarray(A.T @ A))
    gone, kept = np.array([0, 1, 4]), np.array([2, 3, 5, 6])
    rest = jit_quickly(lambda e: marginal(e, gone, kept))(equations)
    covariance = np.linalg.inv(A.T @ A)
    assert np.allclose(np.linalg.inv(rest.information), covariance[np.ix_(kept, kept)], atol=1e-12)
    best = -covariance @ (A.T @ b)
    assert np.allclose(-np.linalg.solve(rest.information, rest.gradient), best[kept], atol=1e-12)
    lowest = rest.cost - 0.5 * rest.gradient @ np.linalg.solve(rest.information, rest.gradient)
    assert float(lowest) == pytest.approx(0.5 * np.sum((A @ best + b) ** 2), rel=1e-9)


def test_padding_changes_nothing():
    graph, values = make(7, num_used=3)
    other = values | {"pose": np.concatenate([values["pose"][:3], np.tile(np.eye(4), (2, 1, 1))])}
    (found, _), (alike, _) = solved(graph, values), solved(graph, other)
    assert np.allclose(found.value["pose"][:3], alike.value["pose"][:3], atol=1e-9)
    assert np.array_equal(found.value["pose"][3:], values["pose"][3:])
