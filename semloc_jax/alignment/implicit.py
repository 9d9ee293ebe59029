"""The pose as a differentiable function of everything that it was found from (room: alignment; pure JAX).

In: start pose, SmoothScene, Prior. Out: SmoothEstimate, whose pose and covariance have derivatives by every float leaf.

Contract
- `align_differentiable(T_init, scene, prior, config, textures)` runs the fast solve where textures are given, then
  `smooth_optimum`, Newton's method on the smooth cost down to the precision of the float type.
- The derivative is that of the implicit function F(y, theta) = 0, F the force (gradient of the cost by the pose):
  dy = -J^-1 (dF/dtheta) dtheta with J = dF/dy. J is the full Hessian. The Gauss-Newton matrix leaves out the curvature
  of loss and boundary, which is no small part of it: derivatives would be wrong by tens of per cent.
- Forward and reverse mode, jit and vmap work. Derivatives are of first order: the derivative of a derivative is wrong.
- Differentiable by: scene.maps.distance_px (cost-map values), scene.model (class weights, ramp widths, loss scales,
  noise), scene.views (intrinsics, extrinsics T_cam_base, map points, sample weights), scene.nats_per_px, prior
  (T_local_base: offset of GNSS to map; sigma; data of its terms). Not by T_init and not by textures: the optimum does
  not depend on them.
- Rotations and poses enter as 4x4 matrices: differentiate by a tangent xi through T @ lie.exp(xi).
- `estimate.tangent()` is zero, and its derivative is that of the pose as a right tangent (v, omega) in the vehicle.
- Where J is nearly singular the derivative is damped and `status` says SINGULAR; nothing is ever NaN.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, align_one
from semloc_jax.geometry import lie
from semloc_jax.residuals.noise import is_inlier
from semloc_jax.residuals.pose_terms import terms_cost, terms_equations
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.smooth import (
    ChannelModel,
    SmoothBorder,
    SmoothScene,
    distance_maps,
    smooth_cost,
    smooth_distances,
    smooth_weights,
)
from semloc_jax.residuals.smooth_curvature import cost_expansion
from semloc_jax.residuals.texture import RampTextures
from semloc_jax.solvers.implicit import damped_inverse, implicit_step
from semloc_jax.structs import CostMaps, PoseEstimate, SolveStatus

_HIGHEST = jax.lax.Precision.HIGHEST


@dataclass(frozen=True)
class SmoothConfig:
    """How a pose is made exact. All values are ours."""

    align: AlignConfig = field(default_factory=AlignConfig)
    """The fast solve before."""
    max_steps: int = 60
    """Most evaluations of the polish."""
    singular_below: float = 0.05
    """Curvature, in units of the prior's information, below which a direction counts as singular and is damped."""


class SmoothEstimate(PoseEstimate):
    """A pose estimate whose pose and covariance can be differentiated."""

    T_fixed: Float[Array, "*batch 4 4"]
    """The same pose as a constant."""
    curvature: Float[Array, "*batch"]
    """Smallest singular value of the full Hessian, in units of the prior's information."""
    remainder: Float[Array, "*batch"]
    """What is left to the exact optimum, the largest coordinate [sigma of the prior]."""

    def tangent(self) -> Float[Array, "*batch 6"]:
        """Zero; its derivative is that of the pose as a right tangent (v, omega) [m, rad]."""
        T = lie.compose(lie.inverse(self.T_fixed), self.T_local_base)
        return jnp.concatenate([T[..., :3, 3], _axis_sine(T[..., :3, :3])], axis=-1)


class _Point(NamedTuple):
    """The cost and its derivatives at a pose, by the right tangent in units of the prior's sigmas."""

    T: Float[Array, "4 4"]
    weights: tuple[Float[Array, "cam p"], ...]
    penalties: tuple[Float[Array, "cam p"], ...]
    prior_cost: Float[Array, ""]
    force: Float[Array, "6"]
    jacobian: Float[Array, "6 6"]


class _Loop(NamedTuple):
    point: _Point
    damping: Float[Array, ""]
    step: Float[Array, "6"]
    num_steps: Int[Array, ""]


def smooth_scene(
    evidence: Evidence, maps: CostMaps, config: AlignConfig, level: int = -1, model: ChannelModel | None = None
) -> SmoothScene:
    """The smooth counterpart of the evidence at one level of the cost maps.

    Args:
        evidence: Views and usable pixels; its textures are those of `maps`.
        maps: Cost maps.
        config: Noise and correlation, as in the fast solve.
        level: Level on which the pose is made exact.
        model: None for what the fast solve assumes at this level.

    >>> maps = sj.cost_maps([mask], localizer.shown)
    >>> scene = sj.smooth_scene(evidence, maps, sj.AlignConfig(), level=2)
    >>> scene.maps.distance_px.shape, scene.maps.stride
    ((1, 2, 200, 320), 2)
    """
    dtype = evidence.views[0].p_map.dtype
    model = standard_model(maps, config, level, dtype) if model is None else model
    return SmoothScene(
        evidence.views,
        jax.tree.map(lambda leaf: leaf.astype(dtype), distance_maps(maps, level)),
        evidence.usable,
        model,
        jnp.asarray(config.noise.observations_per_px, dtype),
        SmoothBorder(config.border_px),
    )


def standard_model(maps: CostMaps, config: AlignConfig, level: int = -1, dtype=jnp.float32) -> ChannelModel:
    """The model of every channel that the fast solve assumes at one level."""
    ones = jnp.ones(maps.ramps[level].shape[1], dtype)
    ramp_px = maps.ramp_px[level]
    return ChannelModel(ones, ramp_px * ones, ones, config.noise.floor_px(ramp_px) * ones)


def align_differentiable(
    T_init: Float[Array, "4 4"],
    scene: SmoothScene,
    prior: Prior,
    config: SmoothConfig | None = None,
    textures: RampTextures | None = None,
) -> SmoothEstimate:
    """The pose that aligns the map with the masks, differentiable by everything in `scene` and `prior`.

    Args:
        T_init: Start pose T_local_base relative to the local origin.
        scene: Views, distances, usable pixels and model; see `smooth_scene`.
        prior: Gaussian prior. A sigma of 0 locks a direction.
        config: None for the defaults.
        textures: Textures of the evidence for the fast solve from T_init; None where T_init is near the optimum
            already.

    Returns:
        SmoothEstimate; `status` says NOT_FINITE, NO_EVIDENCE, MAX_STEPS or SINGULAR where it is not CONVERGED.

    >>> scene, prior, T_start, origin_map = sj.differentiable_scene(mask, rig, street, T_near, classes=classes)
    >>> estimate = sj.align_differentiable(T_start, scene, prior)
    >>> estimate.tangent().shape, sj.SolveStatus(int(estimate.status)).name
    ((6,), 'CONVERGED')
    """
    config = config or SmoothConfig()
    T_start = T_init
    if textures is not None:
        views, usable, start_prior = jax.lax.stop_gradient((scene.views, scene.usable, prior))
        evidence = Evidence(views, textures, usable)
        T_start = align_one(jax.lax.stop_gradient(T_init), evidence, start_prior, config.align).T_local_base
    return smooth_optimum(T_start, scene, prior, config)


@partial(jax.jit, static_argnames="config")  # else an eager caller compiles hundreds of single operations
def smooth_optimum(
    T_start: Float[Array, "4 4"], scene: SmoothScene, prior: Prior, config: SmoothConfig
) -> SmoothEstimate:
    """The optimum of the smooth cost near a start pose, as `align_differentiable`."""
    given = (T_start, prior, scene.views, scene.model, scene.nats_per_px)
    sane = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(given)]))
    T_start, prior, views, model, nats_per_px = jax.tree.map(_numbers, given)
    scene = SmoothScene(views, scene.maps, scene.usable, _positive(model), nats_per_px, scene.border)
    point, num_steps = _newton(*jax.lax.stop_gradient((T_start, scene, prior)), config)
    inverse, curvature = damped_inverse(point.jacobian, config.singular_below)
    step = implicit_step(inverse, _force(point.T, scene, prior))
    T = lie.compose(point.T, lie.exp(jax.lax.stop_gradient(prior.sigma) * step))
    remainder = jnp.max(jnp.abs(inverse @ point.force))
    sane &= jnp.isfinite(remainder) & jnp.all(jnp.isfinite(T))
    return _estimate(T, scene, prior, config, sane, num_steps, curvature, remainder)


def _numbers(leaf: Array) -> Array:
    return jnp.where(jnp.isfinite(leaf), leaf, 0) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf


def _positive(model: ChannelModel) -> ChannelModel:
    """The model with lengths that may stand below a fraction line."""
    lengths = (model.ramp_px, model.loss_scale, model.noise_px)
    return ChannelModel(model.weight, *(jnp.maximum(length, 1e-3) for length in lengths))


def _axis_sine(R: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """Axis of a rotation times the sine of its angle: its rotation vector up to third order, smooth everywhere."""
    pairs = ((2, 1), (0, 2), (1, 0))
    return jnp.stack([0.5 * (R[..., i, j] - R[..., j, i]) for i, j in pairs], axis=-1)


def _prior_cost(T: Float[Array, "4 4"], prior: Prior) -> Float[Array, ""]:
    """Half the squared deviation from the prior in units of its sigmas, and its terms; locked directions cost nothing.

    Measured from the prior, not in the chart of a solve: the optimum must not depend on where it was started.
    """
    D = lie.compose(lie.inverse(prior.T_local_base), T)
    xi = jnp.concatenate([D[:3, 3], _axis_sine(D[:3, :3])])
    free = prior.sigma > 0
    r = jnp.where(free, xi / jnp.where(free, prior.sigma, 1.0), 0.0)
    return 0.5 * jnp.sum(r * r) + terms_cost(prior.terms, T)


def _force(T: Float[Array, "4 4"], scene: SmoothScene, prior: Prior) -> Float[Array, "6"]:
    """Gradient of the cost [nats] by the tangent with the weights held, at the weights of T: zero at the solution."""
    weights = smooth_weights(T, scene)
    sigma = jax.lax.stop_gradient(prior.sigma)

    def cost(y: Array) -> Array:
        moved = lie.compose(T, jnp.eye(4, dtype=T.dtype) + jnp.einsum("a,aij->ij", sigma * y, _generators(T.dtype)))
        return smooth_cost(moved, weights, scene) + _prior_cost(moved, prior)

    return jax.grad(cost)(jnp.zeros(6, T.dtype))


def _generators(dtype) -> Float[Array, "6 4 4"]:
    """Derivatives of lie.exp at zero."""
    G = np.zeros((6, 4, 4))
    G[[0, 1, 2], [0, 1, 2], 3] = 1
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0)), start=3):
        G[k, i, j], G[k, j, i] = 1, -1
    return jnp.asarray(G, dtype)


def _evaluate(T: Float[Array, "4 4"], scene: SmoothScene, prior: Prior) -> _Point:
    """Cost, force and full Hessian at T; the same as automatic derivatives of `_force`.

    T exp(xi) has the derivatives T G_a and T (G_a G_b + G_b G_a) / 2 with the generators G.
    """
    G = prior.sigma[:, None, None] * _generators(T.dtype)
    products = jnp.einsum("aij,bjk->abik", G, G, precision=_HIGHEST)
    twice = 0.5 * (products + products.transpose(1, 0, 2, 3))
    expansion = cost_expansion(T, scene)
    T_base_local = lie.inverse(T)
    J = -jnp.einsum("aij,jk->aik", G, T_base_local, precision=_HIGHEST)[:, :3]
    bend = jnp.einsum("abij,jk->abik", twice, T_base_local, precision=_HIGHEST)[:, :, :3]
    force = jnp.einsum("ik,aik->a", expansion.gradient, J, precision=_HIGHEST)
    hessian = jnp.einsum("aik,ikjl,bjl->ab", J, expansion.hessian, J, precision=_HIGHEST)
    hessian = hessian + jnp.einsum("ik,abik->ab", expansion.gradient, bend, precision=_HIGHEST)

    by_T, push = jax.linearize(jax.grad(lambda T: _prior_cost(T, prior)), T)
    moves = jnp.einsum("ij,ajk->aik", T, G, precision=_HIGHEST)
    force = force + jnp.einsum("ij,aij->a", by_T, moves, precision=_HIGHEST)
    hessian = hessian + jnp.einsum("aij,bij->ab", moves, jax.vmap(push)(moves), precision=_HIGHEST)
    hessian = hessian + jnp.einsum("ij,ik,abkj->ab", by_T, T, twice, precision=_HIGHEST)
    locked = jnp.diag(jnp.where(prior.sigma > 0, 0.0, 1.0).astype(T.dtype))
    return _Point(T, expansion.weight, expansion.penalty, _prior_cost(T, prior), force, hessian + locked)


def _evidence(weights: tuple[Array, ...], penalties: tuple[Array, ...]) -> Float[Array, ""]:
    return sum(jnp.sum(weight * penalty) for weight, penalty in zip(weights, penalties, strict=True))


def _newton(
    T_start: Float[Array, "4 4"], scene: SmoothScene, prior: Prior, config: SmoothConfig
) -> tuple[_Point, Int[Array, ""]]:
    """The pose where the force vanishes, by Newton's method with a damping that keeps the curvature positive."""
    dtype = T_start.dtype
    tolerance = _tolerance(dtype)

    def going_on(state: _Loop) -> Array:
        unfinished = (state.num_steps == 0) | (jnp.max(jnp.abs(state.step)) > tolerance)
        return unfinished & (state.num_steps < config.max_steps)

    def advance(state: _Loop) -> _Loop:
        old = state.point
        new = _evaluate(lie.compose(old.T, lie.exp(prior.sigma * state.step)), scene, prior)
        # With the weights of the old place: hiding samples is no progress. At the limit of the float type the cost no
        # longer changes but the gradient does. Only there, since the gradient also vanishes beyond every ramp.
        before = _evidence(old.weights, old.penalties) + old.prior_cost
        change = _evidence(old.weights, jax.tree.map(jnp.subtract, new.penalties, old.penalties))
        change = change + new.prior_cost - old.prior_cost
        calmer = jnp.max(jnp.abs(new.force)) < 0.5 * jnp.max(jnp.abs(old.force))
        calmer &= change < 30 * np.finfo(dtype).eps * before
        finite = jnp.all(jnp.isfinite(new.force)) & jnp.all(jnp.isfinite(new.jacobian))
        accept = (((change < 0) | calmer) & finite) | (state.num_steps == 0)
        point = jax.tree.map(lambda a, b: jnp.where(accept, a, b), new, old)
        eased = jnp.where(state.damping > 0.02, 0.1 * state.damping, 0.0)
        damping = jnp.where(accept, eased, jnp.maximum(10 * state.damping, 1.0))
        return _Loop(point, damping, _step(point, damping), state.num_steps + 1)

    # The loop starts with a step of length zero: the evaluation is compiled once.
    nothing = tuple(jnp.zeros_like(view.weight) for view in scene.views)
    zero, still = jnp.zeros((), dtype), jnp.zeros(6, dtype)
    nowhere = _Point(T_start, nothing, nothing, zero, still, jnp.eye(6, dtype=dtype))
    state = jax.lax.while_loop(going_on, advance, _Loop(nowhere, zero, still, jnp.asarray(0)))
    return state.point, state.num_steps


def _tolerance(dtype) -> float:
    """Smallest step that the float type can tell from none [sigma of the prior]."""
    return float(np.finfo(dtype).eps) ** (2 / 3)


def _step(point: _Point, damping: Array) -> Float[Array, "6"]:
    """Newton's step, damped where the curvature is not that of a minimum and shortened to one sigma."""
    symmetric = 0.5 * (point.jacobian + point.jacobian.T)
    lowest = jnp.linalg.eigvalsh(_finite(symmetric))[0]
    shift = jnp.maximum(damping, jnp.maximum(0.1 - lowest, 0.0))
    step = -jnp.linalg.solve(_finite(point.jacobian) + shift * jnp.eye(6, dtype=symmetric.dtype), point.force)
    step = jnp.where(jnp.all(jnp.isfinite(step)), step, 0.0)
    return step / jnp.maximum(jnp.max(jnp.abs(step)), 1.0)


def _finite(matrix: Array) -> Array:
    return jnp.where(jnp.all(jnp.isfinite(matrix)), matrix, jnp.eye(6, dtype=matrix.dtype))


def _estimate(
    T: Array,
    scene: SmoothScene,
    prior: Prior,
    config: SmoothConfig,
    sane: Array,
    num_steps: Array,
    curvature: Array,
    remainder: Array,
) -> SmoothEstimate:
    """What `semloc_jax.alignment.pose.assess` says about a pose, from the smooth cost."""
    model, sigma = scene.model, prior.sigma
    weights, distances, information, held, scatter = _information(T, scene)
    # Residuals that scatter more than the model says widen the covariance.
    excess = jnp.maximum(scatter / jnp.maximum(held, 1e-9), 1.0)
    known = sigma[:, None] * terms_equations(prior.terms, T).hessian * sigma + jnp.eye(6, dtype=T.dtype)
    information = sigma[:, None] * information * sigma / excess + known
    covariance = sigma[:, None] * jnp.linalg.inv(information) * sigma
    eigenvalues, eigenvectors = jnp.linalg.eigh(jax.lax.stop_gradient(information))

    seen = sum(jnp.sum(weight) for weight in weights)
    everything = scene.nats_per_px * sum(jnp.sum(view.weight) for view in scene.views)
    cost, inlier = jnp.zeros((), T.dtype), jnp.zeros((), T.dtype)
    for view, weight, distance in zip(scene.views, weights, distances, strict=True):
        v = distance / (model.ramp_px * model.loss_scale)[view.channel]
        cost = cost + jnp.sum(weight * LOSSES["tukey"].rho(v)) / LOSSES["tukey"].worst
        inlier = inlier + jnp.sum(weight * is_inlier(v))
    per_seen = 1 / jnp.maximum(seen, 1e-9)
    exact = remainder < 30 * _tolerance(T.dtype)
    status = jnp.where(curvature < config.singular_below, SolveStatus.SINGULAR, SolveStatus.CONVERGED)
    status = jnp.where(exact, status, SolveStatus.MAX_STEPS)
    too_few = seen < config.align.min_visible_px * scene.nats_per_px
    status = jnp.where(too_few, SolveStatus.NO_EVIDENCE, status)
    return SmoothEstimate(
        T_local_base=T,
        covariance=covariance,
        cost=jnp.where(seen > 0, cost * per_seen, 1.0),
        coverage=seen / jnp.maximum(everything, 1e-9),
        inlier_ratio=inlier * per_seen,
        information_eigenvalues=eigenvalues,
        weak_direction=eigenvectors[:, 0],
        num_steps=num_steps,
        status=jnp.where(sane, status, SolveStatus.NOT_FINITE),
        T_fixed=jax.lax.stop_gradient(T),
        curvature=curvature,
        remainder=remainder,
    )


def _information(T: Array, scene: SmoothScene) -> tuple:
    """Weights, distances, Gauss-Newton information of the evidence in the right tangent, held weight and scatter."""
    model, G = scene.model, _generators(T.dtype)
    weights = smooth_weights(T, scene)

    def moved(xi: Array) -> tuple[Array, ...]:
        return smooth_distances(lie.compose(T, jnp.eye(4, dtype=T.dtype) + jnp.einsum("a,aij->ij", xi, G)), scene)

    distances, push = jax.linearize(moved, jnp.zeros(6, T.dtype))
    slopes = jax.vmap(push)(jnp.eye(6, dtype=T.dtype))
    information = jnp.zeros((6, 6), T.dtype)
    held, scatter = jnp.zeros((), T.dtype), jnp.zeros((), T.dtype)
    for view, weight, distance, slope in zip(scene.views, weights, distances, slopes, strict=True):
        reach_px = (model.ramp_px * model.loss_scale)[view.channel]
        precision = model.weight[view.channel] / model.noise_px[view.channel] ** 2
        pull = weight * LOSSES["tukey"].weight(distance / reach_px)
        information = information + jnp.einsum("icp,cp,jcp->ij", slope, precision * pull, slope, precision=_HIGHEST)
        held = held + jnp.sum(pull)
        scatter = scatter + jnp.sum(pull * (distance / model.noise_px[view.channel]) ** 2)
    return weights, distances, information, held, scatter
