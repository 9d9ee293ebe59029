"""Derivatives of a solution: those of the implicit function are those of solving twice, whatever they are by."""

import re
from functools import cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.implicit import SmoothConfig, align_differentiable, smooth_optimum, smooth_scene
from semloc_jax.alignment.pose import AlignConfig, align_one
from semloc_jax.geometry import lie, rigid
from semloc_jax.structs import SolveStatus
from tests.alignment.random_scenes import NUM, RIG, SIGMA, STRIDE, WIDTH, random_trial
from tests.compiling import jit_quickly
from tests.contracts.ground_scene import cost_maps_of, scene

CONFIG = SmoothConfig()
KINDS = {
    "cost-map values": (lambda t: t.scene.maps.distance_px, 1.0),
    "class weights": (lambda t: t.scene.model.weight, 1.0),
    "ramp widths": (lambda t: t.scene.model.ramp_px, 8.0),
    "loss scales": (lambda t: t.scene.model.loss_scale, 1.0),
    "boundary noise": (lambda t: t.scene.model.noise_px, 2.0),
    "correlation": (lambda t: t.scene.nats_per_px, 0.01),
    "sample weights": (lambda t: t.scene.views[0].weight, 5.0),
    "map points": (lambda t: t.scene.views[0].p_map, 0.1),
    "focal lengths": (lambda t: (t.scene.views[0].camera.fx, t.scene.views[0].camera.fy), 1.0),
    "principal point": (lambda t: (t.scene.views[0].camera.cx, t.scene.views[0].camera.cy), 1.0),
    "sigmas of the prior": (lambda t: t.prior.sigma, SIGMA),
    "offset of GNSS to map": (lambda t: t.prior.T_local_base, None),
    "extrinsics": (lambda t: t.scene.views[0].T_cam_base, None),
}


def changed(trial, amounts, seed):
    """The trial with every kind of argument moved by its amount, in a direction drawn at random."""
    for k, (where, scale) in enumerate(KINDS.values()):

        def moved(leaf, k=k, scale=scale):
            rng = np.random.default_rng(seed + k)
            if scale is None:
                xi = amounts[k] * jnp.asarray(rng.normal(size=6) * SIGMA, leaf.dtype)
                return leaf @ lie.exp(xi)
            return leaf + amounts[k] * jnp.asarray(scale * rng.normal(size=leaf.shape), leaf.dtype)

        trial = eqx.tree_at(where, trial, jax.tree.map(moved, where(trial)))
    return trial


def solve(trial, amounts, seed=0):
    trial = changed(trial, amounts, seed)
    return smooth_optimum(jax.lax.stop_gradient(trial.prior.T_local_base), trial.scene, trial.prior, CONFIG)


def tangents(trial, amounts):
    """Derivative of the right tangent of the pose by each amount, in sigmas: [6 kind]; and the estimate."""

    def tangent(amounts):
        estimate = solve(trial, amounts)
        return estimate.tangent() / trial.prior.sigma, estimate

    return jax.jacrev(tangent, has_aux=True)(amounts)


@cache
def differentiate():
    """Compiled once for everything here: 100 random scenes and the special ones behind them."""
    return jit_quickly(jax.vmap(tangents, in_axes=(0, None)))


@cache
def trials():
    special = two_lines(1e-3), *broken()
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *map(random_trial, range(100)), *special)


@cache
def solved():
    return differentiate()(trials(), jnp.zeros(len(KINDS)))


def two_lines(nats_per_px):
    """Samples on one column of the image between two lines that pull alike: no force, and a curvature below zero."""
    trial = random_trial(0)
    reach_px = np.asarray(trial.scene.model.ramp_px * trial.scene.model.loss_scale)
    column = (np.arange(WIDTH // STRIDE) + 0.5) * STRIDE - 0.5
    off = (column - float(RIG.cameras[0].cx)) + np.array([[0.7], [-0.7]]) * reach_px[0]
    maps = np.broadcast_to(off[None, :, None], trial.scene.maps.distance_px.shape)
    p_cam = np.stack([np.zeros(NUM), np.tile(np.linspace(0.5, 1.2, NUM // 2), 2), np.full(NUM, 6.0)])
    T = np.asarray(trial.T_true) @ RIG.T_base_cam[0]
    where = (
        lambda t: t.scene.maps.distance_px,
        lambda t: t.scene.views[0].p_map,
        lambda t: t.scene.views[0].channel,
        lambda t: t.scene.views[0].weight,
        lambda t: t.scene.model,
        lambda t: t.scene.nats_per_px,
        lambda t: t.prior.T_local_base,
    )
    alike = jax.tree.map(lambda leaf: jnp.full(2, leaf[0]), trial.scene.model)
    channel = np.repeat([0, 1], NUM // 2)[None]
    values = (
        jnp.asarray(maps),
        jnp.asarray((T[:3, :3] @ p_cam + T[:3, 3:])[None]),
        jnp.asarray(channel, jnp.int32),
        jnp.full((1, NUM), 8.0),
        alike,
        jnp.asarray(nats_per_px),
        trial.T_true,
    )
    return eqx.tree_at(lambda t: [leaf(t) for leaf in where], trial, list(values))


def broken():
    """A map point, a pixel and a prior that are no numbers, and a view without evidence."""
    trial = random_trial(1)
    nowhere = {
        "point": (lambda t: t.scene.views[0].p_map, lambda leaf: leaf.at[0, 0, 3].set(jnp.nan)),
        "prior": (lambda t: t.prior.T_local_base, lambda leaf: leaf.at[0, 3].set(jnp.inf)),
        "noise": (lambda t: t.scene.model.noise_px, jnp.zeros_like),
        "pixels": (lambda t: t.scene.maps.distance_px, lambda leaf: jnp.full_like(leaf, jnp.nan)),
        "nothing": (lambda t: t.scene.usable.mask, jnp.zeros_like),
    }
    return [eqx.tree_at(where, trial, change(where(trial))) for where, change in nowhere.values()]


def test_every_scene_converges_to_the_optimum():
    _, estimate = solved()
    assert np.array_equal(estimate.status[:100], [SolveStatus.CONVERGED] * 100)
    assert float(estimate.remainder[:100].max()) < 1e-9
    assert float(estimate.inlier_ratio[:100].min()) > 0.8


def finite_differences(amounts, h=1e-5):
    """Change of the pose [sigma] in each of the hundred scenes along some amounts, by solving twice."""
    ahead, behind = (
        np.asarray(differentiate()(trials(), jnp.asarray(step * amounts))[1].T_local_base)[:100] for step in (h, -h)
    )
    return rigid.log(rigid.inverse(behind) @ ahead) / (2 * h) / SIGMA


def assert_same_in_a_hundred_scenes(directions):
    implicit = np.asarray(solved()[0])[:100]
    for amounts in directions:
        finite = finite_differences(amounts)
        size = np.linalg.norm(finite, axis=1)
        assert size.min() > 1e-6
        assert np.max(np.linalg.norm(implicit @ amounts - finite, axis=1) / size) < 0.01


def test_implicit_derivatives_are_finite_differences_in_a_hundred_scenes():
    """Within 1 % of their size in every scene, with all 13 kinds of argument changed at once."""
    typical = np.median(np.linalg.norm(np.asarray(solved()[0])[:100], axis=1), axis=0)
    signs = np.random.default_rng(3).choice([-1.0, 1.0], (2, len(KINDS)))
    assert_same_in_a_hundred_scenes(signs * 0.1 / typical)


@pytest.mark.slow
def test_so_are_those_by_each_kind_of_argument_alone():
    assert_same_in_a_hundred_scenes(np.eye(len(KINDS)))


def test_a_singular_scene_is_told_and_its_derivatives_are_finite():
    """With the weight at which the evidence takes away all curvature of the prior; ten per cent less is regular."""
    _, estimate = solved()
    lost = (1 - float(estimate.curvature[100])) / 1e-3
    assert lost > 0
    for share, status in ((1.0, SolveStatus.SINGULAR), (0.9, SolveStatus.CONVERGED)):
        scenes = eqx.tree_at(
            lambda t: t.scene.nats_per_px, trials(), trials().scene.nats_per_px.at[100].set(share / lost)
        )
        derivatives, estimate = differentiate()(scenes, jnp.zeros(len(KINDS)))
        assert SolveStatus(int(estimate.status[100])) == status
        assert float(estimate.curvature[100]) == pytest.approx(1 - share, abs=1e-6)
        assert np.isfinite(derivatives[100]).all()
        assert np.isfinite(estimate.covariance[100]).all()


def test_what_is_no_number_is_told_and_nothing_becomes_nan():
    derivatives, estimate = solved()
    states = [SolveStatus(int(status)).name for status in estimate.status[101:]]
    assert states[:2] == ["NOT_FINITE"] * 2
    assert states[4] == "NO_EVIDENCE"
    assert np.isfinite(derivatives).all()
    for leaf in jax.tree.leaves(estimate):
        assert np.isfinite(leaf).all()
    # Without evidence the pose goes where the offset of the prior goes, and nothing else moves it.
    offset = list(KINDS).index("offset of GNSS to map")
    others = np.delete(np.asarray(derivatives[105]), offset, axis=1)
    assert np.abs(others).max() < 1e-9
    assert np.linalg.norm(derivatives[105][:, offset]) > 0.5


@pytest.mark.slow
def test_the_polish_stays_where_the_fast_solve_ends_and_a_gradient_adds_no_loop_to_it():
    """A thousand samples of one camera in float32: half a centimetre, 0.05 deg; the derivative is one linear solve."""
    world = scene("radtan", 1000, dtype=np.float32)
    world = eqx.tree_at(lambda w: w.views[0].weight, world, 10 * world.views[0].weight)
    coarse_to_fine = AlignConfig(levels=(0, 1), max_steps=15)
    config, off = SmoothConfig(align=coarse_to_fine), (0.2, -0.15, 0.01, 0.003, -0.002, 0.02)
    given = smooth_scene(world.evidence, cost_maps_of("radtan"), coarse_to_fine)
    prior, start, textures = world.prior(off), world.moved(off), world.textures

    def forward(views):
        scene = eqx.tree_at(lambda s: s.views, given, views)
        return align_differentiable(start, scene, prior, config, textures)

    inexact, rest = eqx.partition(given.views, eqx.is_inexact_array)
    pose = jax.jit(lambda views: forward(eqx.combine(views, rest)))
    loss = jax.jit(jax.grad(lambda views: jnp.sum(forward(eqx.combine(views, rest)).tangent() / prior.sigma)))
    estimate, gradient = pose(inexact), loss(inexact)
    assert SolveStatus(int(estimate.status)) == SolveStatus.CONVERGED
    fast = jax.jit(partial(align_one, config=coarse_to_fine))(start, world.evidence, prior)
    moved = np.abs(np.asarray(lie.log(lie.inverse(fast.T_local_base) @ estimate.T_local_base)))
    assert moved[:3].max() < 0.005
    assert np.degrees(moved[3:].max()) < 0.05
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    assert _num_loops(loss, inexact) == _num_loops(pose, inexact) > 0


def _num_loops(function, argument):
    """Loops in the program of a function."""
    return len(re.findall(r"= (?:while|scan)\[", str(jax.make_jaxpr(function)(argument))))
