"""Derivatives of a solution: those of the implicit function are those of solving twice, whatever they are by."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.geometry import lie
from semloc_jax.solvers.implicit import SmoothConfig, polish
from semloc_jax.structs import SolveStatus
from tests.solvers.random_scenes import SIGMA, random_trials

CONFIG = SmoothConfig()
KINDS = {
    "cost-map values": (lambda t: t.scene.maps.distance_px, 1.0),
    "class weights": (lambda t: t.scene.model.weight, 1.0),
    "ramp widths": (lambda t: t.scene.model.ramp_px, 8.0),
    "kernel scales": (lambda t: t.scene.model.kernel_scale, 1.0),
    "boundary noise": (lambda t: t.scene.model.noise_px, 2.0),
    "correlation": (lambda t: t.scene.nats_per_px, 0.01),
    "sample weights": (lambda t: t.scene.views[0].weight, 5.0),
    "map points": (lambda t: t.scene.views[0].p_map, 0.1),
    "focal lengths": (lambda t: (t.scene.views[0].camera.fx, t.scene.views[0].camera.fy), 1.0),
    "principal point": (lambda t: (t.scene.views[0].camera.cx, t.scene.views[0].camera.cy), 1.0),
    "sigmas of the prior": (lambda t: t.prior.sigma, SIGMA),
    "offset of GNSS to map": (lambda t: t.prior.T_map_base, None),
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
    return polish(jax.lax.stop_gradient(trial.prior.T_map_base), trial.scene, trial.prior, CONFIG)


def tangents(trial, amounts):
    """Derivative of the right tangent of the pose by each amount, in sigmas: [6 kind]; and the estimate."""

    def tangent(amounts):
        estimate = solve(trial, amounts)
        return estimate.tangent() / trial.prior.sigma, estimate

    return jax.jacrev(tangent, has_aux=True)(amounts)


@cache
def hundred():
    return random_trials(range(100))


@cache
def solved():
    """Implicit derivatives and estimates of a hundred scenes at their own arguments."""
    return jax.jit(jax.vmap(tangents, in_axes=(0, None)))(hundred(), jnp.zeros(len(KINDS)))


def test_every_scene_converges_to_the_optimum():
    _, estimate = solved()
    assert np.array_equal(estimate.status, [SolveStatus.CONVERGED] * 100)
    assert float(estimate.remainder.max()) < 1e-9
    assert float(estimate.inlier_ratio.min()) > 0.8


def test_implicit_derivatives_are_finite_differences_in_a_hundred_scenes():
    """Within 1 % of the size of each derivative, for each of 13 kinds of argument."""
    h, num = 1e-5, len(KINDS)
    steps = h * np.concatenate([np.eye(num), -np.eye(num)])
    again = jax.vmap(lambda amounts, trial: solve(trial, amounts).T_map_base, in_axes=(None, 0))
    Ts = np.asarray(jax.jit(lambda steps, t: jax.lax.map(lambda a: again(a, t), steps))(jnp.asarray(steps), hundred()))
    implicit, _ = solved()
    finite = np.asarray(lie.log(lie.inverse(Ts[num:]) @ Ts[:num])) / (2 * h) / SIGMA
    finite = np.moveaxis(finite, 0, 2)
    size = np.linalg.norm(finite, axis=1)
    error = np.linalg.norm(np.asarray(implicit) - finite, axis=1)
    assert size.min() > 1e-6
    worst = np.max(error / size, axis=0)
    assert worst.max() < 0.01, dict(zip(KINDS, worst.round(4), strict=True))
