"""One cost term, written once: a single pose, window, filter, tracker, calibration and a whole drive all take it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import semloc_jax as sj
from semloc_jax.alignment.pose import AlignConfig, level_problem
from semloc_jax.alignment.problem import quadratic_model, residual
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.inertial_fusion import InertialFusion
from semloc_jax.fusion.kalman import KalmanFusion
from semloc_jax.fusion.pose_factors import GraphConfig, pose_graph, values_of
from semloc_jax.fusion.window import SlidingWindow, WindowConfig
from semloc_jax.geometry import rigid
from semloc_jax.residuals.motion import cauchy
from semloc_jax.residuals.pose_terms import from_origin, joined, terms_cost, terms_residual
from semloc_jax.solvers.front import solve
from tests.compiling import jit_quickly
from tests.contracts.calibration_scene import build
from tests.contracts.ground_scene import scene
from tests.fusion import fusion_drive as drive

BEACONS_MAP = np.array([[12.0, 6.0, 3.0], [-4.0, -9.0, 2.5]])
SIGMA_M = 0.05
OFF = np.array([0.12, -0.07, 0.015, 0.004, -0.003, 0.012])


def range_residual(T_map_base, beacon_map, range_m, sqrt_info):
    """Whitened difference of the distance to a beacon from the measured one [sigma]."""
    return sqrt_info * (jnp.linalg.norm(T_map_base[:3, 3] - beacon_map) - range_m)[None]


def ranges(T_map_base, beacons_map=BEACONS_MAP, sigma_m=SIGMA_M, robust=None):
    """Exact ranges from a pose to beacons."""
    range_m = np.linalg.norm(T_map_base[:3, 3] - beacons_map, axis=1)
    return sj.pose_term(range_residual, (beacons_map, range_m), np.full(len(range_m), 1.0 / sigma_m), robust)


@pytest.mark.parametrize("robust", [None, cauchy(2.0)], ids=["squares", "robust"])
def test_single_pose_cost_and_gradient(robust):
    """Half the squared residual, its gradient and the fused model agree, away from the origin of the chart too."""
    world = scene("radtan")
    term = ranges(np.asarray(world.moved(3.0 * OFF)), robust=robust)
    prior = replace(world.prior(-0.5 * OFF), terms=(term,))
    y = np.array([0.05, -0.1, 0.2, 0.3, -0.2, 0.1])

    @jit_quickly
    def of_all(y, T_start, world, prior):
        problem = level_problem(T_start, world.views, 1, world.evidence, prior, AlignConfig())
        half = jax.value_and_grad(lambda y: 0.5 * jnp.sum(residual(y, problem) ** 2))(y)
        return half, quadratic_model(y, problem), quadratic_model(y, replace(problem, terms=()))

    (cost, gradient), model, alone = of_all(y, world.moved(OFF), world, prior)
    assert float(model.cost) == pytest.approx(float(cost), rel=1e-9) and float(model.cost) > float(alone.cost) + 0.5
    np.testing.assert_allclose(model.gradient, gradient, rtol=1e-6, atol=1e-6 * np.abs(gradient).max())


def test_an_origin_moves_nothing():
    T = rigid.exp(np.array([40.0, -30.0, 2.0, 0.1, 0.0, 0.4]))
    origin_map = np.array([35.0, -28.0, 1.0])
    local = T.copy()
    local[:3, 3] -= origin_map
    term = ranges(T @ rigid.exp(OFF))
    assert float(terms_cost((term,), jnp.asarray(T))) == pytest.approx(
        float(terms_cost(from_origin((term,), origin_map), jnp.asarray(local))), rel=1e-9
    )
    assert float(jnp.sum(terms_residual((term,), jnp.asarray(T)) ** 2) / 2) == pytest.approx(
        float(terms_cost((term,), jnp.asarray(T)))
    )


def followed(fusion, num_steps, T_terms):
    """A drive with a measured pose at its start only, and ranges at every step."""
    poses = drive.true_poses(num_steps)
    state = fusion.start(drive.measured(0, poses[0] @ rigid.exp(OFF)))
    for k in range(num_steps):
        state = fusion.predict(state, drive.increment(k, None, fusion.pose(state).calibration))
        state, innovation = fusion.correct_term(state, T_terms(poses[k + 1]))
        assert innovation.accepted and innovation.dof == 3
    return fusion.pose(state), poses[-1]


def near_ranges(T):
    """Ranges to three beacons around the vehicle, which is far from the origin of the map."""
    beacons_map = T[:3, 3].round() + np.array([[30.0, 10.0, 4.0], [-10.0, 35.0, 3.0], [5.0, -25.0, 6.0]])
    return ranges(T, beacons_map, 0.1)


NO_KERNEL = GraphConfig(pose_threshold=1e6, fix_threshold=1e6)


@pytest.mark.parametrize("fusion", ["window", "kalman"])
def test_ranges_alone_carry_a_fusion(fusion):
    """Start 15 cm off; then odometry and ranges of 10 cm: within 5 cm and three sigmas."""
    kinds = (near_ranges(np.eye(4)),)
    made = SlidingWindow(WindowConfig(5, graph=NO_KERNEL), terms=kinds) if fusion == "window" else KalmanFusion()
    found, T_true = followed(made, 30, near_ranges)
    off = drive.error(found.T_map_base, T_true)
    assert np.linalg.norm(off[:2]) < 0.05
    assert np.all(np.abs(off) < 3.0 * np.sqrt(np.diag(found.covariance)))


def test_ranges_correct_the_fusion_without_wheels():
    """A start 15 cm off and ranges of 10 cm, all at one time: nearer in the plane, and surer."""
    fusion, T = InertialFusion(), drive.true_poses(0)[0]
    state = fusion.start(drive.measured(0, T @ rigid.exp(OFF), sigma=10.0 * drive.POSE_SIGMA))
    after, innovation = fusion.correct_term(state, near_ranges(T))
    assert innovation.accepted and innovation.dof == 3
    before, now = (np.linalg.norm(drive.error(fusion.pose(s).T_map_base, T)[:2]) for s in (state, after))
    assert now < 0.5 * before
    assert np.trace(fusion.pose(after).covariance[:2, :2]) < 0.1 * np.trace(fusion.pose(state).covariance[:2, :2])


def test_marginalisation_keeps_what_terms_knew():
    """A window of 5 after 12 steps is the window that never forgot, within a tenth of a sigma."""
    kinds = (near_ranges(np.eye(4)),)
    short, _ = followed(SlidingWindow(WindowConfig(5, graph=NO_KERNEL), terms=kinds), 12, near_ranges)
    whole, _ = followed(SlidingWindow(WindowConfig(14, graph=NO_KERNEL), terms=kinds), 12, near_ranges)
    sigma = np.sqrt(np.diag(whole.covariance))
    assert np.all(np.abs(drive.error(short.T_map_base, whole.T_map_base)) < 0.1 * sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(short.covariance)), sigma, rtol=0.05)


def test_a_window_refuses_what_does_not_fit():
    kinds = (near_ranges(np.eye(4)),)
    fusion = SlidingWindow(WindowConfig(5, graph=NO_KERNEL), terms=kinds)
    T = drive.true_poses(0)[0]
    state = fusion.start(drive.measured(0, T))
    far, lost = near_ranges(T @ rigid.exp(np.array([5.0, 0, 0, 0, 0, 0]))), near_ranges(T)
    lost.data[1][0] = np.nan
    for term in (far, lost):
        same, innovation = fusion.correct_term(state, term)
        assert same is state and not innovation.accepted
    with pytest.raises(SemlocError, match=r"its kinds are: range_residual"):
        fusion.correct_term(state, sj.pose_term(range_residual, (np.zeros((1, 2)), np.ones(1)), np.ones((1, 1))))
    state, _ = fusion.correct_term(state, near_ranges(T))
    with pytest.raises(SemlocError, match="3 more observations of range_residual at one time, 0 of 3 rows"):
        fusion.correct_term(state, near_ranges(T))


def test_a_whole_drive_takes_the_terms_of_all_its_poses():
    """Ten poses with nothing but motion noise of 0.3 m and ranges: every pose ends within 2 cm."""
    poses = np.stack(drive.true_poses(9))
    told = joined([(near_ranges(T),) for T in poses])
    assert len(told) == 1 and len(told[0].keys[0]) == 30
    rng = np.random.default_rng(2)
    start = np.stack([T @ rigid.exp(0.3 * rng.normal(size=6) * [1, 1, 1, 0, 0, 0]) for T in poses])
    graph = pose_graph(np.ones(10, bool), told)
    free = graph.free | {"pose": np.tile([True] * 3 + [False] * 3, (10, 1))}
    graph = replace(graph, free=free)
    found = solve(graph, values_of(start, np.array([1.0, 0, 0, 0, 0])), GraphConfig().solve)
    assert np.abs(found.value["pose"][:, :3, 3] - poses[:, :3, 3]).max() < 0.02


@pytest.mark.slow
def test_calibration_takes_terms():
    """The normal equations with terms are those of the residuals, by finite differences."""
    problem, state = build("radtan", (0.05, 0.1, -0.02, 0.0), (), 150)
    told = joined([(ranges(np.asarray(T) @ rigid.exp(OFF)),) for T in state.T_local_base])
    with_terms = replace(problem, terms=told)
    num, size = len(state.T_local_base), len(problem.sigma)

    @jit_quickly
    def cost(problem, x):
        moved = problem.retract(state, (x[: 6 * num].reshape(num, 6), x[6 * num :]))
        return 0.5 * jnp.sum(problem.residuals(moved) ** 2)

    @jit_quickly
    def equations(problem):
        return problem.linearise(state, jnp.asarray(False))

    step = 1e-5
    axes = step * np.eye(6 * num + size)[: 6 * num]
    slopes = np.array([(cost(with_terms, d) - cost(with_terms, -d)) / (2.0 * step) for d in axes])
    given = np.asarray(equations(with_terms).link_gradient).ravel()
    np.testing.assert_allclose(given, slopes, atol=1e-4 * np.abs(slopes).max())
    assert np.abs(given - np.asarray(equations(problem).link_gradient).ravel()).max() > 10.0
