"""Every peer solves the same problem: the same cost, the same pose at the end, the same number of steps."""

from functools import cache

import jax
import numpy as np
import pytest

from semloc_jax.alignment.pose import level_problem, visible_views
from semloc_jax.alignment.problem import pose_of, residual
from semloc_jax.bench.host_model import LevelModel, right_jacobian, tangent
from semloc_jax.bench.ours import config_of, evidence_of
from semloc_jax.bench.peer import PEERS, PeerMissing, create
from semloc_jax.bench.problem import SIGMA, displacement, make_problem, rotation

LEVELS = (1, 3)
OFF = np.array([[0.3, -0.2, 0.03, 0.004, -0.003, 0.01], [-0.25, 0.15, -0.02, -0.003, 0.004, -0.012]])


@cache
def problem():
    return make_problem(384)


def test_numpy_and_package_agree_on_every_residual():
    """Two programs that share no code give the same numbers at the same pose."""
    T_start = problem().T_true @ displacement(OFF[:1])[0]
    evidence, prior = evidence_of(problem())

    @jax.jit
    def ours(T, y, level):
        views = visible_views(T, evidence, problem().border_px, "xla")
        at_level = level_problem(T, views, level, evidence, prior, config_of("xla"))
        return pose_of(y, at_level), residual(y, at_level)

    y = np.array([0.1, -0.1, 0.05, 0, 0, 0])  # without a turn the two charts are the same
    for level in (0, 1, 3):
        host = LevelModel(problem(), level, T_start)
        T, mine = map(np.asarray, ours(T_start.astype(np.float32), y.astype(np.float32), level))
        assert np.allclose(T, host.pose(y), atol=1e-5)
        theirs = host.residual(y)
        num = len(theirs) - 6
        assert np.abs(theirs[:num]).max() > 0.3
        assert np.abs(mine[:num] - theirs[:num]).max() < 3e-3
        assert np.abs(mine[-6:] - theirs[-6:]).max() < 0.02  # the prior's two logarithms differ by the second order


def test_the_jacobian_by_hand_is_the_derivative():
    host = LevelModel(problem(), 1, problem().T_true @ displacement(OFF[1:])[0])
    y = np.array([0.05, -0.1, 0.1, 0.3, -0.2, 0.4])
    _, jacobian = host.residual_and_jacobian(y)
    step = 1e-6
    for k in range(6):
        d = step * np.eye(6)[k]
        difference = (host.residual(y + d) - host.residual(y - d)) / (2 * step)
        # A few points cross from one texel to the next within the step.
        assert np.mean(np.abs(jacobian[:, k] - difference) < 1e-4 * max(1, np.abs(difference).max())) > 0.99


def test_the_chart_of_the_hosts():
    omega, d = np.array([0.2, -0.3, 0.1]), np.array([1e-6, -2e-6, 3e-6])
    turned = rotation((omega + d)[None])[0]
    expected = rotation(omega[None])[0] @ rotation((right_jacobian(omega) @ d)[None])[0]
    assert np.abs(turned - expected).max() < 1e-11
    xi = np.array([1.0, 2.0, 3.0, *omega])
    assert tangent(displacement(xi[None])[0]) == pytest.approx(xi, abs=1e-12)


@cache
def reference_cost():
    """Cost at the end of both starts by scipy in float64 on the numpy model: nothing of the package is in it."""
    from scipy.optimize import least_squares

    poses = []
    for T in problem().T_true @ displacement(OFF):
        for level in LEVELS:
            model = LevelModel(problem(), level, T)
            found = least_squares(model.residual, np.zeros(6), lambda y, m=model: m.residual_and_jacobian(y)[1])
            T = model.pose(found.x)
        poses.append(T)
    return np.stack(poses)


@pytest.mark.parametrize("name", [entry.name for entry in PEERS])
def test_every_peer_ends_at_the_same_pose(name):
    try:
        peer = create(name)
    except PeerMissing as missing:
        pytest.skip(f"{name}: {missing}")
    peer.load(problem())
    solved = peer.solve(problem().T_true @ displacement(OFF), LEVELS)
    if hasattr(peer, "close"):
        peer.close()
    distance, angle = problem().errors(solved.Ts_map_base)
    assert distance.max() < 0.02, "2 cm from the truth"
    assert angle.max() < 0.06
    off = np.linalg.inv(reference_cost()) @ solved.Ts_map_base
    away = np.abs([tangent(T) for T in off]) / SIGMA
    # Twice the step at which everybody stops.
    assert away.max() < 2 * problem().tolerance
    limit = 10 if name != "scipy-2point" else 70
    assert 2 * len(LEVELS) <= solved.evaluations <= limit * len(LEVELS)
    assert solved.cpu_s is None or 0 < solved.cpu_s < 1
