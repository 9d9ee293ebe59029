"""Many hypotheses: what survives a cull, what a pose costs, and how modes are weighed."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.hypotheses import CullStage, cull, keep_distinct, prior_cost, score, weigh
from semloc_jax.alignment.pose import AlignConfig, Prior
from semloc_jax.alignment.proposals import propose
from semloc_jax.geometry import lie
from semloc_jax.structs import PoseEstimate
from tests.compiling import jit_quickly
from tests.contracts.ground_scene import scene

# Operation by operation each would be some forty programs.
exp, se2_to_se3 = jit_quickly(lie.exp), jit_quickly(lie.se2_to_se3)
prior_cost, weigh = jit_quickly(prior_cost), jit_quickly(weigh)


def poses(x, y, yaw_deg):
    return se2_to_se3(jnp.asarray(x, float), jnp.asarray(y, float), jnp.radians(jnp.asarray(yaw_deg, float)))


def test_survivors_differ_from_every_better_one():
    """Oracle: the greedy rule written with loops, on random poses."""
    rng = np.random.default_rng(0)
    x, y, yaw = rng.uniform(-3, 3, 300), rng.uniform(-3, 3, 300), rng.uniform(-180, 180, 300)
    scores = rng.normal(size=300)
    for apart in (0.3, 2.0, 8.0):
        index, filled = keep_distinct(poses(x, y, yaw), jnp.asarray(scores), 40, apart)
        expected = []
        for i in np.argsort(scores):
            turn = (yaw - yaw[i] + 180) % 360 - 180
            distance = np.sqrt(((x - x[i]) / 0.5) ** 2 + ((y - y[i]) / 0.5) ** 2 + (turn / 1.0) ** 2)
            if all(distance[k] >= apart for k in expected):
                expected.append(int(i))
        count = min(40, len(expected))
        assert [int(i) for i, f in zip(index, filled, strict=True) if f] == expected[:count]
        assert int(filled.sum()) == count


def test_headings_meet_at_half_a_turn():
    index, filled = keep_distinct(poses([0, 0, 0], [0, 0, 0], [179.9, -179.9, 0.0]), jnp.array([0.0, 1.0, 2.0]), 3, 1.0)
    assert [int(i) for i, f in zip(index, filled, strict=True) if f] == [0, 2]


def test_scores_that_are_no_numbers_never_survive():
    Ts = poses([0, 5, 10, 15], [0, 0, 0, 0], [0, 0, 0, 0])
    index, filled = keep_distinct(Ts, jnp.array([jnp.nan, 3.0, jnp.inf, -jnp.inf]), 4, 1.0)
    assert list(np.asarray(filled)) == [True, False, False, False]
    assert int(index[0]) == 1


def estimates(covariance, num):
    def row(value):
        return jnp.broadcast_to(jnp.asarray(value), (num, *np.shape(value)))

    return PoseEstimate(
        T_local_base=poses(np.arange(num), np.zeros(num), np.zeros(num)),
        covariance=jnp.asarray(covariance),
        cost=jnp.arange(num) / 10.0,
        coverage=row(1.0),
        inlier_ratio=row(1.0),
        information_eigenvalues=row(np.ones(6)),
        weak_direction=row(np.eye(6)[0]),
        num_steps=row(3),
        status=row(0),
    )


def test_weights_are_laplaces():
    """exp(-score) sqrt(det covariance), best score first, summing to 1; an empty slot weighs nothing."""
    rng = np.random.default_rng(1)
    factors = rng.normal(size=(4, 6, 6)) * 0.1
    covariance = factors @ factors.transpose(0, 2, 1) + 1e-3 * np.eye(6)
    scores = np.array([2.0, 0.5, np.inf, 1.0])
    modes = weigh(estimates(covariance, 4), jnp.asarray(scores))
    order = [1, 3, 0, 2]
    expected = np.exp(-scores) * np.sqrt(np.linalg.det(covariance))
    np.testing.assert_allclose(modes.weight, (expected / expected.sum())[order], rtol=1e-9)
    np.testing.assert_allclose(modes.score, scores[order])
    np.testing.assert_allclose(modes.estimates.cost, np.array(order) / 10.0)
    assert float(modes.weight[3]) == 0.0


def test_locked_directions_do_not_count_in_the_width():
    covariance = np.diag([0.04, 0.01, 0.0, 0.0, 0.0, 1e-4])
    wide = covariance * 4.0
    modes = weigh(estimates(np.stack([covariance, wide]), 2), jnp.zeros(2))
    # Twice as wide in each of three free directions: 8 times the weight.
    assert float(modes.weight[1] / modes.weight[0]) == pytest.approx(8.0, rel=1e-9)


def test_modes_without_any_finite_score_weigh_nothing():
    modes = weigh(estimates(np.tile(np.eye(6), (3, 1, 1)), 3), jnp.full(3, jnp.inf))
    assert np.array_equal(modes.weight, np.zeros(3))


def test_prior_costs_half_the_squared_sigmas():
    T = exp(jnp.array([3.0, 1.0, 0.0, 0.0, 0.01, 0.4]))
    xi = jnp.array([0.3, -0.2, 0.01, 0.001, 0.0, 0.02])
    sigma = jnp.array([0.5, 0.5, 0.02, 0.01, 0.01, 0.04])
    expected = 0.5 * np.sum((np.asarray(xi) / np.asarray(sigma)) ** 2)
    assert float(prior_cost(T @ exp(xi), Prior(T, sigma))) == pytest.approx(expected, rel=1e-9)
    locked = 0.5 * ((0.3 / 0.5) ** 2 + (0.2 / 0.5) ** 2)
    assert float(prior_cost(T @ exp(xi), Prior(T, sigma.at[2:].set(0.0)))) == pytest.approx(locked, rel=1e-9)


@pytest.fixture(scope="module")
def world():
    plain = scene("mixed", dtype=np.float32)
    return eqx.tree_at(lambda w: [v.weight for v in w.views], plain, [10 * v.weight for v in plain.views])


def test_a_pose_gains_nothing_by_hiding_or_looking_away(world):
    rate = jax.jit(score, static_argnames="config")
    config, wide = AlignConfig(), world.prior(sigma=[50.0, 50.0, 1.0, 1.0, 1.0, 10.0])

    def cost(T, evidence=world.evidence):
        return float(rate(T, jnp.asarray(1), evidence, wide, config=config))

    T_beside = world.moved([0.5, 0.4, 0, 0, 0, 0.02])
    true, beside = cost(world.T_true), cost(T_beside)
    turned = cost(world.moved([0, 0, 0, 0, 0, np.pi / 2]))
    gone = cost(world.moved([500.0, 0, 0, 0, 0, 0])) - float(prior_cost(world.moved([500.0, 0, 0, 0, 0, 0]), wide))
    assert true < beside
    assert beside < turned
    # Where nothing is visible the whole view counts as missed.
    assert gone > turned
    half = eqx.tree_at(lambda e: e.usable.mask, world.evidence, world.usable.mask.at[:, :, ::2].set(False))
    assert cost(T_beside, half) == pytest.approx(beside, rel=0.15)


def test_one_stage_keeps_the_truth_among_distinct_survivors(world):
    """From 128 starts within +-1 m, +-1 m, +-5 deg, refined on the coarse level only."""
    sigma = jnp.array([1.0, 1.0, np.radians(5.0)], jnp.float32)
    starts = propose("lattice", 128, world.moved([0.5, -0.4, 0, 0, 0, 0.05]), sigma, 1.0, jax.random.key(0))
    prior = world.prior([0.5, -0.4, 0, 0, 0, 0.05], sigma=[1.0, 1.0, 0.05, 0.01, 0.01, 0.09])
    stage = CullStage(levels=(0,), score_level=1, keep=8, apart=0.5)
    Ts, scores = cull(starts, stage, world.evidence, prior, AlignConfig(), 32)
    assert Ts.dtype == np.float32 and Ts.shape == (8, 4, 4)
    filled = np.isfinite(scores)
    assert np.all(np.diff(np.asarray(scores)[filled]) >= 0)
    found = np.asarray(lie.log(lie.inverse(world.T_true) @ Ts[0]))
    assert np.hypot(*found[:2]) < 0.05
    assert np.degrees(abs(found[5])) < 0.3
    xy = np.asarray(Ts)[filled][:, :2, 3]
    yaw = np.asarray(lie.yaw(Ts))[filled]
    for i in range(len(xy)):
        for k in range(i):
            assert np.hypot(np.hypot(*(xy[i] - xy[k])) / 0.5, (yaw[i] - yaw[k]) / np.radians(1.0)) >= 0.499
    # An empty slot repeats the best pose, with an infinite score.
    for k in np.flatnonzero(~filled):
        assert np.array_equal(Ts[k], Ts[0])
