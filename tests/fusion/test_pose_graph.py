"""Pose graph against gtsam and scipy: optimum, joint covariance, loop closures, derivatives, marginals."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from semloc_jax.fusion.pose_graph import (
    GraphConfig,
    NormalEquations,
    PoseGraph,
    graph_residuals,
    linearise,
    marginal,
    solve_pose_graph,
)
from semloc_jax.geometry import rigid
from semloc_jax.residuals.motion import robust_cost

NUM = 5
CONFIG = GraphConfig(pose_threshold=1e6, fix_threshold=1e6, edge_threshold=3.0, tolerance=1e-6)
POSE_SIGMA = np.array([0.10, 0.05, 0.05, 0.01, 0.01, 0.005])
EDGE_SIGMA = np.array([0.02, 0.01, 0.01, 0.002, 0.002, 0.001])
RESIDUALS = jax.jit(graph_residuals)
SOLVE = jax.jit(lambda graph: solve_pose_graph(graph, CONFIG))


def true_poses():
    step = rigid.exp(np.array([2.0, 0.1, 0.0, 0.01, -0.02, 0.3]))
    poses = [rigid.exp(np.array([50.0, -30.0, 3.0, 0.1, -0.1, 2.0]))]
    for _ in range(NUM - 1):
        poses.append(poses[-1] @ step)
    return poses


def make(seed=0, loop=None, calibrated=False):
    """A noisy chain with a measured pose at each state and one more edge from the first to the last state."""
    rng = np.random.default_rng(seed)
    poses = true_poses()
    ends = [(k, k + 1) for k in range(NUM - 1)] + [(0, NUM - 1)]
    edges = [rigid.inverse(poses[a]) @ poses[b] @ rigid.exp(rng.normal(size=6) * EDGE_SIGMA) for a, b in ends]
    if loop is not None:
        edges[-1] = edges[-1] @ loop
    measured = np.array([T @ rigid.exp(rng.normal(size=6) * POSE_SIGMA) for T in poses])
    num_edges = len(ends)
    jacobian = np.zeros((num_edges, 6, 2))
    if calibrated:
        jacobian[:-1, 0, 0], jacobian[:-1, 5, 1] = 2.0, -0.2
    fields = {
        "T_map_base": measured,
        "calibration": np.array([1.0, 0.0, 0.0, 0.0]),
        "used": np.ones(NUM, bool),
        "T_measured": measured,
        "pose_sqrt_info": np.tile(np.diag(1 / POSE_SIGMA), (NUM, 1, 1)),
        "edge_from": np.array([a for a, _ in ends]),
        "edge_to": np.array([b for _, b in ends]),
        "T_edge": np.array(edges),
        "edge_sqrt_info": np.tile(np.diag(1 / EDGE_SIGMA), (num_edges, 1, 1)),
        "edge_jacobian": jacobian,
        "edge_calibration": np.tile([1.0, 0.0], (num_edges, 1)),
        "edge_robust": np.zeros(num_edges, bool),
        "p_fix": np.array([T[:2, 3] for T in poses]) + [2.0, -1.0] + 0.3 * rng.normal(size=(NUM, 2)),
        "fix_sqrt_info": np.full((NUM, 2), 2.0 if calibrated else 0.0),
        "fix_base": np.tile([0.5, 0.2, 1.5], (NUM, 1)),
        "T_prior": poses[0] @ rigid.exp(rng.normal(size=6) * POSE_SIGMA),
        "calibration_prior": np.array([1.0, 0.0, 0.0, 0.0]),
        "prior_sqrt_info": np.diag([*np.zeros(6), 50.0, 300.0, 0.3, 0.3]) + 0.1 * np.eye(10, k=2),
    }
    return PoseGraph(**{name: jnp.asarray(value) for name, value in fields.items()})


def moved(x, graph):
    Ts = np.asarray(graph.T_map_base) @ rigid.exp(x[:-4].reshape(-1, 6))
    return jnp.asarray(Ts), jnp.asarray(np.asarray(graph.calibration) + x[-4:])


def test_optimum_and_covariance_are_those_of_gtsam():
    gtsam = pytest.importorskip("gtsam")
    graph = eqx.tree_at(lambda g: g.prior_sqrt_info, make(), jnp.diag(jnp.array([0.0] * 6 + [1.0] * 4)))

    # gtsam's tangent of a pose is (rotation, translation).
    def noise(sigma):
        return gtsam.noiseModel.Diagonal.Sigmas(np.concatenate([sigma[3:], sigma[:3]]))

    factors, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, T in enumerate(np.asarray(graph.T_measured)):
        factors.add(gtsam.PriorFactorPose3(k, gtsam.Pose3(T), noise(POSE_SIGMA)))
        start.insert(k, gtsam.Pose3(T))
    for a, b, T in zip(graph.edge_from, graph.edge_to, np.asarray(graph.T_edge), strict=True):
        factors.add(gtsam.BetweenFactorPose3(int(a), int(b), gtsam.Pose3(T), noise(EDGE_SIGMA)))
    best = gtsam.LevenbergMarquardtOptimizer(factors, start).optimize()
    solution = SOLVE(graph)
    covariance = np.linalg.inv(solution.equations.information)
    marginals = gtsam.Marginals(factors, best)
    order = [3, 4, 5, 0, 1, 2]
    for k in range(NUM):
        off = rigid.log(rigid.inverse(best.atPose3(k).matrix()) @ np.asarray(solution.T_map_base[k]))
        assert np.linalg.norm(off[:3]) < 1e-5 and np.linalg.norm(off[3:]) < 1e-6
        mine = covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6]
        theirs = marginals.marginalCovariance(k)[np.ix_(order, order)]
        assert np.allclose(np.sqrt(np.diag(mine)), np.sqrt(np.diag(theirs)), rtol=1e-3)
        assert np.allclose(mine, theirs, atol=2e-3 * np.sqrt(np.outer(np.diag(theirs), np.diag(theirs))))


def test_calibration_offset_and_fixes_against_scipy():
    graph = make(3, calibrated=True)
    solution = SOLVE(graph)
    best = least_squares(lambda x: np.asarray(RESIDUALS(*moved(x, graph), graph)), np.zeros(6 * NUM + 4), x_scale="jac")
    Ts, calibration = moved(best.x, graph)
    assert bool(solution.converged)
    assert float(solution.equations.cost) == pytest.approx(best.cost, rel=1e-6)
    assert np.allclose(solution.calibration, calibration, atol=1e-4)
    assert np.allclose(solution.T_map_base, Ts, atol=1e-4)


def test_normal_equations_are_the_derivatives_of_the_residuals():
    graph = make(4, calibrated=True)
    x0 = np.zeros(6 * NUM + 4)

    def residuals(x):
        return np.asarray(RESIDUALS(*moved(x, graph), graph))

    step = 1e-6
    J = np.array([(residuals(x0 + step * d) - residuals(x0 - step * d)) / (2 * step) for d in np.eye(len(x0))]).T
    equations = jax.jit(lambda g: linearise(g.T_map_base, g.calibration, g, CONFIG))(graph)
    scale = np.sqrt(np.diag(J.T @ J))
    assert np.allclose(equations.information / np.outer(scale, scale), (J.T @ J) / np.outer(scale, scale), atol=1e-6)
    assert np.allclose(equations.gradient / scale, J.T @ residuals(x0) / scale, atol=1e-5)
    assert float(equations.cost) == pytest.approx(0.5 * np.sum(residuals(x0) ** 2), rel=1e-9)


def test_a_wrong_loop_closure_is_outvoted_when_it_is_robust():
    """A loop that is 1.5 m off: 3 cm with the robust kernel, decimetres without."""
    clean = SOLVE(make(5))
    errors = []
    for is_robust in (True, False):
        graph = make(5, loop=rigid.exp(np.array([1.5, 0, 0, 0, 0, 0])))
        graph = eqx.tree_at(
            lambda g: g.edge_robust, graph, jnp.arange(NUM) == NUM - 1 if is_robust else graph.edge_robust
        )
        off = np.asarray(SOLVE(graph).T_map_base - clean.T_map_base)[:, :3, 3]
        errors.append(np.max(np.linalg.norm(off, axis=1)))
    assert errors[0] < 0.03 and errors[1] > 0.2


def test_robust_cost_is_quadratic_near_zero_and_logarithmic_far_away():
    for size in (0.01, 2.0, 40.0):
        r = size * jnp.array([0.6, -0.8, 0.0])
        cost, weight = robust_cost(r, 3.0)
        assert float(cost) == pytest.approx(4.5 * np.log1p((size / 3.0) ** 2), rel=1e-6)
        gradient = jax.grad(lambda q: robust_cost(q, 3.0)[0])(r)
        assert np.allclose(gradient, weight**2 * r, atol=1e-9)


def test_marginal_is_the_covariance_of_what_is_kept():
    rng = np.random.default_rng(6)
    A, b = rng.normal(size=(20, 7)), rng.normal(size=20)
    equations = NormalEquations(jnp.asarray(0.5 * b @ b), jnp.asarray(A.T @ b), jnp.asarray(A.T @ A))
    gone, kept = np.array([0, 1, 4]), np.array([2, 3, 5, 6])
    rest = jax.jit(lambda e: marginal(e, gone, kept))(equations)
    covariance = np.linalg.inv(A.T @ A)
    assert np.allclose(np.linalg.inv(rest.information), covariance[np.ix_(kept, kept)], atol=1e-12)
    best = -covariance @ (A.T @ b)
    assert np.allclose(-np.linalg.solve(rest.information, rest.gradient), best[kept], atol=1e-12)
    lowest = rest.cost - 0.5 * rest.gradient @ np.linalg.solve(rest.information, rest.gradient)
    assert float(lowest) == pytest.approx(0.5 * np.sum((A @ best + b) ** 2), rel=1e-9)


def test_padding_changes_nothing():
    graph = make(7)
    is_used = jnp.arange(NUM) < 3
    cut = eqx.tree_at(
        lambda g: (g.used, g.pose_sqrt_info, g.edge_sqrt_info),
        graph,
        (
            is_used,
            graph.pose_sqrt_info * is_used[:, None, None],
            graph.edge_sqrt_info * (jnp.arange(NUM) < 2)[:, None, None],
        ),
    )
    other = eqx.tree_at(lambda g: g.T_map_base, cut, cut.T_map_base.at[3:].set(jnp.eye(4)))
    assert np.allclose(SOLVE(cut).T_map_base[:3], SOLVE(other).T_map_base[:3], atol=1e-9)
