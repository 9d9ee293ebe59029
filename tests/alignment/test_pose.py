"""One pose: accuracy on exact evidence, covariance against dense algebra, and every way in which a solve can fail."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.pose import (
    AlignConfig,
    Evidence,
    Prior,
    align_many,
    align_one,
    assess,
    level_problem,
    visible_views,
)
from semloc_jax.alignment.problem import residual
from semloc_jax.geometry import rigid
from semloc_jax.residuals.alignment import Usable
from semloc_jax.structs import STATUS_TEXT, SolveStatus
from tests.compiling import jit_quickly
from tests.contracts.ground_scene import scene

LEVELS = AlignConfig(levels=(0, 1), max_steps=15)
OFF = np.array([0.4, -0.25, 0.02, 0.003, -0.002, 0.03])
NOWHERE = jnp.full((4, 4), jnp.nan, jnp.float32)


@cache
def world_of(name, dtype=np.float32):
    """A scene with as much contour in view as a road has: 400 samples of 30 px each."""
    world = scene(name, dtype=dtype)
    return eqx.tree_at(lambda w: [v.weight for v in w.views], world, [20 * v.weight for v in world.views])


solve = jax.jit(align_one, static_argnames="config")


def error(estimate, world):
    """Tangent from the truth to the estimate."""
    return rigid.log(rigid.inverse(np.asarray(world.T_true, float)) @ np.asarray(estimate.T_local_base, float))


def assert_all_finite(estimate):
    for leaf in jax.tree.leaves(estimate):
        assert np.isfinite(leaf).all()


@pytest.mark.parametrize("name", ["radtan", "mixed"])
def test_finds_the_truth_from_half_a_metre_and_two_degrees(name):
    world = world_of(name)
    estimate = solve(world.moved(OFF), world.evidence, world.prior(OFF), config=LEVELS)
    assert SolveStatus(int(estimate.status)) == SolveStatus.CONVERGED
    assert estimate.T_local_base.dtype == np.float32
    found = error(estimate, world)
    # The prior is off by OFF and pulls by a few parts in a hundred; boundaries are exact to a hundredth of a pixel.
    assert np.abs(found[:2]).max() < 0.02
    assert np.degrees(abs(found[5])) < 0.15
    assert float(estimate.cost) < 0.01
    assert float(estimate.inlier_ratio) > 0.98
    assert float(estimate.coverage) > 0.9


def test_same_input_same_bits():
    world = world_of("radtan")
    first, second = (solve(world.moved(OFF), world.evidence, world.prior(OFF), config=LEVELS) for _ in range(2))
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        assert np.array_equal(one, other)


def test_many_starts_are_one_start_each():
    world = world_of("radtan")
    offsets = np.array([OFF, -OFF, 0.5 * OFF, np.zeros(6), 0.1 * OFF])
    Ts = jnp.stack([world.moved(xi) for xi in offsets])
    many = eqx.filter_jit(lambda Ts, e, p: align_many(Ts, e, p, LEVELS, chunk=2))(Ts, world.evidence, world.prior(OFF))
    for k, T in enumerate(Ts):
        one = solve(T, world.evidence, world.prior(OFF), config=LEVELS)
        np.testing.assert_allclose(many.T_local_base[k], one.T_local_base, atol=2e-4)
        assert int(many.status[k]) == int(one.status)


def test_covariance_is_the_inverse_of_the_dense_information():
    world = world_of("mixed", np.float64)
    prior = world.prior()
    estimate = jax.jit(assess, static_argnames="config")(
        world.T_true, jnp.asarray(1), world.evidence, prior, config=LEVELS
    )

    @jit_quickly
    def jacobian(T, evidence, prior):
        problem = level_problem(T, visible_views(T, evidence, LEVELS.border_px), 1, evidence, prior, LEVELS)
        return jax.jacfwd(residual)(jnp.zeros(6), problem)

    J = np.asarray(jacobian(world.T_true, world.evidence, prior))
    S = np.diag(np.asarray(world.sigma))
    # Residuals at the truth are so small that the kernel is quadratic and their scatter adds nothing.
    np.testing.assert_allclose(estimate.covariance, S @ np.linalg.inv(J.T @ J) @ S, rtol=1e-3, atol=1e-12)
    np.testing.assert_allclose(estimate.information_eigenvalues, np.linalg.eigvalsh(J.T @ J), rtol=1e-3)
    assert np.all(np.diff(estimate.information_eigenvalues) >= 0)


def test_a_top_view_says_that_height_and_tilt_are_only_assumed():
    """An orthographic view of a plane holds x, y and yaw; the rest keeps the sigmas of the prior."""
    world = world_of("bev", np.float64)
    estimate = jax.jit(assess, static_argnames="config")(
        world.T_true, jnp.asarray(1), world.evidence, world.prior(), config=LEVELS
    )
    sigma = np.sqrt(np.diag(estimate.covariance))
    np.testing.assert_allclose(sigma[2:5], np.asarray(world.sigma)[2:5], rtol=0.05)
    assert (sigma[[0, 1, 5]] < 0.1 * np.asarray(world.sigma)[[0, 1, 5]]).all()
    assert np.linalg.norm(np.asarray(estimate.weak_direction)[2:5]) > 0.999
    assert float(estimate.information_eigenvalues[0]) == pytest.approx(1.0, abs=0.02)


def test_locked_directions_do_not_move_at_all():
    """From a level start, with height, roll and pitch locked: their entries keep every bit, their covariance is 0."""
    world = world_of("radtan")
    level = jnp.asarray(rigid.planar_pose(31.2, -12.1, 0.72, 0.02).astype(np.float32))
    estimate = solve(level, world.evidence, Prior(level, world.sigma.at[2:5].set(0.0)), config=LEVELS)
    T = np.asarray(estimate.T_local_base)
    assert np.array_equal(T[2], [0.0, 0.0, 1.0, np.float32(0.02)])
    assert np.array_equal(T[:2, 2], [0.0, 0.0])
    assert np.linalg.norm(T[:2, 3] - [31.2, -12.1]) > 0.1
    assert np.array_equal(np.asarray(estimate.covariance)[2:5], np.zeros((3, 6)))
    everything = solve(world.moved(OFF), world.evidence, world.prior(sigma=np.zeros(6)), config=LEVELS)
    assert np.array_equal(everything.T_local_base, world.moved(OFF))


def broken(world, what):
    """Start, evidence and prior of a way to fail."""
    start, evidence, prior = world.moved(OFF), world.evidence, world.prior()
    if what == "empty map":
        weights = [jnp.zeros_like(view.weight) for view in evidence.views]
        evidence = eqx.tree_at(lambda e: [view.weight for view in e.views], evidence, weights)
    if what == "nothing usable":
        evidence = eqx.tree_at(lambda e: e.usable.mask, evidence, jnp.zeros_like(evidence.usable.mask))
    if what == "empty masks":
        full = jnp.full_like(evidence.textures.texels, 0xFEFEFEFE)
        evidence = eqx.tree_at(lambda e: e.textures.texels, evidence, full)
    if what == "all behind":
        start = world.moved([0, 0, 0, 0, 0, np.pi])
        prior = Prior(start, prior.sigma)
    return start, evidence, prior


@pytest.mark.parametrize(
    ("what", "status"),
    [
        ("empty map", SolveStatus.NO_EVIDENCE),
        ("nothing usable", SolveStatus.NO_EVIDENCE),
        ("all behind", SolveStatus.NO_EVIDENCE),
        ("empty masks", SolveStatus.CONVERGED),
    ],
)
def test_without_evidence_the_prior_stands(what, status):
    """Nothing pulls the pose off the centre of the prior, nothing is NaN, and the covariance is the prior's."""
    world = world_of("radtan")
    start, evidence, prior = broken(world, what)
    estimate = solve(start, evidence, prior, config=LEVELS)
    assert SolveStatus(int(estimate.status)) == status
    assert_all_finite(estimate)
    np.testing.assert_allclose(estimate.T_local_base, prior.T_local_base, atol=8e-3)  # a hundredth of the sigmas
    np.testing.assert_allclose(estimate.covariance, np.diag(np.asarray(prior.sigma) ** 2), rtol=1e-3, atol=1e-7)
    assert float(estimate.cost) == pytest.approx(1.0, abs=1e-5)
    assert float(estimate.inlier_ratio) == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_start_that_is_no_number_ends_at_the_prior(bad):
    world = world_of("radtan")
    start = world.moved(OFF).at[0, 3].set(bad)
    estimate = solve(start, world.evidence, world.prior(), config=LEVELS)
    assert SolveStatus(int(estimate.status)) == SolveStatus.NOT_FINITE
    assert "NaN" in STATUS_TEXT[SolveStatus(int(estimate.status))]
    assert np.array_equal(estimate.T_local_base, world.prior().T_local_base)


def test_a_prior_that_is_no_number_ends_at_the_start():
    world = world_of("radtan")
    for prior in (Prior(NOWHERE, world.sigma), Prior(world.T_true, jnp.full(6, jnp.nan, jnp.float32))):
        estimate = solve(world.moved(OFF), world.evidence, prior, config=LEVELS)
        assert SolveStatus(int(estimate.status)) == SolveStatus.NOT_FINITE
        assert np.array_equal(estimate.T_local_base, world.moved(OFF))


def test_neither_start_nor_prior_still_gives_a_pose():
    world = world_of("radtan")
    estimate = solve(NOWHERE, world.evidence, Prior(NOWHERE, world.sigma), config=LEVELS)
    assert SolveStatus(int(estimate.status)) == SolveStatus.NOT_FINITE
    assert np.array_equal(estimate.T_local_base, np.eye(4))


def test_too_few_steps_are_said():
    world = world_of("radtan")
    estimate = solve(world.moved(OFF), world.evidence, world.prior(OFF), config=replace(LEVELS, max_steps=2))
    assert SolveStatus(int(estimate.status)) == SolveStatus.MAX_STEPS
    assert int(estimate.num_steps) == 4


def test_a_level_finer_than_the_scatter_is_left_again():
    """Samples scattered by a metre: few of them lie on the 6 px ramp, so the pose is that of the 20 px ramp."""
    world = world_of("radtan")
    rng = np.random.default_rng(0)
    (view,) = world.views
    scattered = view.p_map.at[:, :2].add(rng.normal(size=(1, 2, 400)).astype(np.float32))
    evidence = eqx.tree_at(lambda e: e.views[0].p_map, world.evidence, scattered)
    both = solve(world.T_true, evidence, world.prior(), config=LEVELS)
    coarse = solve(world.T_true, evidence, world.prior(), config=replace(LEVELS, levels=(0,)))
    fine = jax.jit(assess, static_argnames="config")(both.T_local_base, 1, evidence, world.prior(), config=LEVELS)
    assert float(fine.inlier_ratio) < LEVELS.min_inlier_ratio
    np.testing.assert_allclose(both.T_local_base, coarse.T_local_base, atol=1e-6)


def test_ignored_pixels_are_not_evidence():
    """With half of the image unusable, coverage halves and the pose stays right."""
    world = world_of("radtan")
    mask = world.usable.mask.at[:, :, :60].set(False)
    evidence = Evidence(world.views, world.textures, Usable(mask, world.usable.stride))
    estimate = solve(world.moved(0.5 * OFF), evidence, world.prior(), config=LEVELS)
    whole = solve(world.moved(0.5 * OFF), world.evidence, world.prior(), config=LEVELS)
    assert 0.2 < float(estimate.coverage) < 0.8 < float(whole.coverage)
    assert np.abs(error(estimate, world)[:2]).max() < 0.02
    assert np.trace(estimate.covariance) > np.trace(whole.covariance)
