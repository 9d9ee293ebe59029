"""The cost of a window of inertial states and landmarks, and what is left when states go (room: fusion; pure JAX).

In: StateFactors (inertial sensor, vehicle, measured poses), Views of landmarks, WindowPrior. Out: WindowProblem for
the one solver; `left_by_oldest`: the prior that the oldest state leaves.
First estimates: a state that the prior touches keeps the value at which it was first linearised in every derivative
(Huang, Mourikis, Roumeliotis, IJRR 2010); otherwise the window would think that it sees the yaw.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.geometry import lie
from semloc_jax.residuals.inverse_depth import Sight, sight_linearised, sight_residual
from semloc_jax.residuals.motion import between_residual, cauchy, cauchy_cost, pose_residual
from semloc_jax.residuals.preintegration import InertialState, Preintegrated, imu_residual
from semloc_jax.residuals.vehicle_motion import (
    change_residual,
    rolling_residual,
    standing_residual,
    wheel_speed_residual,
)
from semloc_jax.solvers.dense import DenseEquations, dense_hessian, marginal
from semloc_jax.solvers.factors import POSE, Factors, vector
from semloc_jax.solvers.graph import FactorGraph, Family, Steps, Values, split, units_of
from semloc_jax.solvers.problem import Step
from semloc_jax.solvers.schur import SchurEquations

GRAVITY_MAP = (0.0, 0.0, -9.81)
VELOCITY = vector(0.5, 0.5, 0.5)
BIAS = vector(0.005, 0.005, 0.005, 0.1, 0.1, 0.1)
SCALE = vector(0.02)
LANDMARK_UNITS = (0.01, 0.01, 0.05)
SIZES = {"pose": 6, "velocity": 3, "bias": 6, "scale": 1}
STATE = sum(SIZES.values())
"""Unknowns of one state."""
_HIGHEST = jax.lax.Precision.HIGHEST


class WindowPrior(eqx.Module):
    """What is known of the states from before: cost = g d + 0.5 d H d, d from the first estimates."""

    first: Values
    """First estimates of every state, by family."""
    touched: Bool[Array | np.ndarray, " f"]
    """States that the prior knows of."""
    held: Bool[Array | np.ndarray, " f"]
    """States whose derivatives are taken at their first estimates: those touched, but for the very first prior."""
    gradient: Float[Array | np.ndarray, " d"]
    information: Float[Array | np.ndarray, "d d"]


class StateFactors(NamedTuple):
    """What sensors say of the states; `sqrt_info` 0 switches a factor off."""

    steps: Preintegrated | None
    """Of every interval, with a leading axis; None until they are integrated at the present biases."""
    inertial: Float[Array | np.ndarray, "e 9 9"]
    walk: Float[Array | np.ndarray, "e 6"]
    scale_walk: Float[Array | np.ndarray, "e 1"]
    rolling: Float[Array | np.ndarray, "f 2"]
    speed_mps: Float[Array | np.ndarray, " f"]
    wheels: Float[Array | np.ndarray, "f 1"]
    standing: Float[Array | np.ndarray, "f 3"]
    still: Float[Array | np.ndarray, "e 6 6"]
    """Of the motion of nothing between two states of a vehicle that stands."""
    T_measured: Float[Array | np.ndarray, "f 4 4"]
    measured: Float[Array | np.ndarray, "f 6 6"]


class Views(NamedTuple):
    """Landmarks and the times that see them."""

    anchor: Int[Array | np.ndarray, " l"]
    """State that saw the landmark first."""
    camera: Int[Array | np.ndarray, " l"]
    axes: Float[Array | np.ndarray, "l 3 3"]
    """R_cam_axes at the anchor."""
    ray_cam: Float[Array | np.ndarray, "l f 3"]
    pixels: Float[Array | np.ndarray, "l f 2 3"]
    sqrt_info: Float[Array | np.ndarray, "l f"]
    """1 / standard deviation [1/px]; 0 where the landmark is not seen."""
    T_base_cam: Float[Array | np.ndarray, "f c 4 4"]


class WindowProblem(eqx.Module):
    """Cost over {pose, velocity, bias, scale, landmark}; see `LeastSquaresProblem`."""

    factors: StateFactors
    views: Views
    prior: WindowPrior
    threshold: float = eqx.field(static=True)
    """Of the whitened distance of a landmark beyond which its pull grows no more."""

    def linearise(self, value: Values, skip: Bool[Array, ""]) -> SchurEquations:
        """Normal equations; derivatives of touched states at their first estimates."""
        at = self.slopes_at(value)
        graph = frame_graph(self.factors)
        local = graph.local(value, at)
        g = graph.gradients(local)
        gradient = jnp.concatenate([g[family.name].ravel() for family in graph.families])
        information = dense_hessian(graph, local, graph.families)
        cost = sum(jnp.sum(part.cost) for part in local)
        seen = _seen(self.views, value, at, self.threshold)
        num = seen.gradient.size
        d = self.difference(value)
        pull = jnp.matmul(self.prior.information, d, precision=_HIGHEST)
        cost += seen.cost + jnp.dot(self.prior.gradient, d) + 0.5 * jnp.dot(d, pull)
        gradient = (gradient + self.prior.gradient + pull).at[:num].add(seen.gradient.ravel())
        information = (information + self.prior.information).at[:num, :num].add(seen.information)
        return SchurEquations(cost, gradient, information, seen.landmark_gradient, seen.landmark, seen.across)

    def step(self, equations: SchurEquations, damping: Float[Array, ""]) -> Step:
        """The damped step of every variable."""
        families = families_of(len(self.prior.touched))
        dtype = equations.gradient.dtype
        units, own = jnp.asarray(units_of(families), dtype), jnp.asarray(LANDMARK_UNITS, dtype)
        step = equations.step(damping, units, own)
        frames, landmarks = step.tangent
        return step._replace(tangent=split(frames, families) | {"landmark": landmarks})

    def retract(self, value: Values, tangent: Steps) -> Values:
        """The values after a step."""
        families = families_of(len(self.prior.touched))
        moved = {f.name: f.kind.retract(value[f.name], tangent[f.name]) for f in families}
        return moved | {"landmark": value["landmark"] + tangent["landmark"]}

    def slopes_at(self, value: Values) -> Values:
        """Where derivatives are taken: held states at their first estimates, all of them moved by one translation.

        A change of scale moves the whole window along its way. Without the translation, held and new states would lie
        apart by that, and the baselines of the derivatives would be wrong. It leaves the null space of the prior as
        it is: yaw and position of the whole.
        """
        held = jnp.asarray(self.prior.held)
        first = dict(self.prior.first)
        first["pose"] = jnp.asarray(first["pose"]).at[:, :3, 3].add(common_shift(self.prior, value["pose"]))

        def chosen(first: Array, now: Array) -> Array:
            return jnp.where(jnp.reshape(held, (-1,) + (1,) * (now.ndim - 1)), first, now)

        return {name: chosen(jnp.asarray(first[name]), jnp.asarray(value[name])) for name in SIZES}

    def difference(self, value: Values) -> Float[Array, " d"]:
        """The states less the first estimates of those that the prior touches, zero for the others."""
        T_first = jnp.asarray(self.prior.first["pose"])
        parts = [lie.log(lie.compose(lie.inverse(T_first), value["pose"]))]
        parts += [value[name] - self.prior.first[name] for name in ("velocity", "bias", "scale")]
        kept = jnp.asarray(self.prior.touched)[:, None]
        return jnp.concatenate([jnp.where(kept, part, 0.0).ravel() for part in parts])


def common_shift(prior: WindowPrior, Ts_map_base: Float[Array | np.ndarray, "f 4 4"]) -> Float[Array, "3"]:
    """Mean translation of the held states from their first estimates."""
    held = jnp.asarray(prior.held)[:, None]
    moved = jnp.asarray(Ts_map_base)[:, :3, 3] - jnp.asarray(prior.first["pose"])[:, :3, 3]
    return jnp.sum(jnp.where(held, moved, 0.0), axis=0) / jnp.maximum(jnp.sum(held), 1)


def families_of(num: int) -> tuple[Family, ...]:
    """The variables of so many states; their order is that of the unknowns."""
    kinds = {"pose": POSE, "velocity": VELOCITY, "bias": BIAS, "scale": SCALE}
    return tuple(Family(name, kind, num) for name, kind in kinds.items())


def unknowns_of(states: Int[np.ndarray, " k"], num: int) -> Int[np.ndarray, " d"]:
    """Places of all unknowns of the named states among those of a window of `num`."""
    found, start = [], 0
    for size in SIZES.values():
        found.append((start + states[:, None] * size + np.arange(size)).ravel())
        start += num * size
    return np.concatenate(found)


def frame_graph(factors: StateFactors) -> FactorGraph:
    """Everything but landmarks and prior."""
    num = len(factors.rolling)
    here, before = np.arange(num), np.arange(num - 1)
    after, robust = before + 1, cauchy(4.0)
    parts = (
        Factors(
            _inertial,
            ("pose", "velocity", "bias", "pose", "velocity"),
            (before, before, before, after, after),
            (factors.steps,),
            factors.inertial,
        ),
        Factors(change_residual, ("bias", "bias"), (before, after), (), factors.walk),
        Factors(change_residual, ("scale", "scale"), (before, after), (), factors.scale_walk),
        Factors(rolling_residual, ("pose", "velocity"), (here, here), (), factors.rolling, robust=cauchy(3.0)),
        Factors(
            wheel_speed_residual,
            ("pose", "velocity", "scale"),
            (here, here, here),
            (factors.speed_mps,),
            factors.wheels,
            robust=cauchy(3.0),
        ),
        Factors(standing_residual, ("velocity",), (here,), (), factors.standing),
        Factors(_still, ("pose", "pose"), (before, after), (), factors.still),
        Factors(pose_residual, ("pose",), (here,), (factors.T_measured,), factors.measured, robust=robust),
    )
    return FactorGraph(families_of(num), jax.tree.map(jnp.asarray, parts))


def left_by_oldest(problem: WindowProblem, value: Values, num_gone: int) -> DenseEquations:
    """What the oldest states and the landmarks first seen by them say of the others, with the prior, at the values.

    The unknowns are those of the other states, at their places in a window that is so many states shorter.
    """
    factors, num = problem.factors, len(problem.prior.touched)
    on_edge, on_state = (jnp.arange(n) < num_gone for n in (num - 1, num))

    def masked(sqrt_info: Array, mask: Array) -> Array:
        return jnp.where(mask.reshape(-1, *(1,) * (jnp.ndim(sqrt_info) - 1)), sqrt_info, 0.0)

    own = factors._replace(
        **{name: masked(getattr(factors, name), on_edge) for name in ("inertial", "walk", "scale_walk", "still")},
        **{name: masked(getattr(factors, name), on_state) for name in ("rolling", "wheels", "standing", "measured")},
    )
    views = problem.views._replace(
        sqrt_info=masked(problem.views.sqrt_info, jnp.asarray(problem.views.anchor) < num_gone)
    )
    oldest = eqx.tree_at(lambda p: (p.factors, p.views), problem, (own, views))
    left, _ = oldest.linearise(value, jnp.asarray(False)).reduced()
    return marginal(left, unknowns_of(np.arange(num_gone), num), unknowns_of(np.arange(num_gone, num), num))


class _Seen(NamedTuple):
    """Normal equations of the views of landmarks."""

    cost: Float[Array, ""]
    gradient: Float[Array, "f 6"]
    information: Float[Array, "f6 f6"]
    landmark_gradient: Float[Array, "l 3"]
    landmark: Float[Array, "l 3 3"]
    across: Float[Array, "l f6 3"]


def _arguments(views: Views, value: Values) -> tuple:
    """Arguments of the residual of every landmark and time, [l f ...]."""
    num_l, num_f = jnp.shape(views.sqrt_info)
    T_base_cam = jnp.asarray(views.T_base_cam)[:, views.camera].swapaxes(0, 1)
    anchor = jnp.asarray(views.anchor)
    T_anchor_cam = jnp.take_along_axis(T_base_cam, anchor[:, None, None, None], axis=1)
    many = (num_l, num_f)
    sight = Sight(
        jnp.broadcast_to(jnp.asarray(views.axes)[:, None], (*many, 3, 3)),
        jnp.broadcast_to(T_anchor_cam, (*many, 4, 4)),
        T_base_cam,
        jnp.asarray(views.ray_cam),
        jnp.asarray(views.pixels),
    )
    T_map_anchor = jnp.broadcast_to(value["pose"][anchor][:, None], (*many, 4, 4))
    T_map_base = jnp.broadcast_to(value["pose"][None], (*many, 4, 4))
    landmark = jnp.broadcast_to(value["landmark"][:, None], (*many, 3))
    return T_map_anchor, T_map_base, landmark, sight, jnp.asarray(views.sqrt_info)


def sight_residuals(views: Views, value: Values) -> Float[Array, "l f 2"]:
    """Whitened residuals of all views; zero where a landmark is not seen."""
    return jax.vmap(jax.vmap(sight_residual))(*_arguments(views, value))


def _seen(views: Views, value: Values, at: Values, threshold: float) -> _Seen:
    r = sight_residuals(views, value)
    _, Ja, Jk, Jl = jax.vmap(jax.vmap(sight_linearised))(*_arguments(views, at | {"landmark": value["landmark"]}))
    cost, root = jax.vmap(jax.vmap(lambda one: cauchy_cost(_kept_from_zero(one), threshold)))(r)
    r, Ja, Jk, Jl = r * root[..., None], *(J * root[..., None, None] for J in (Ja, Jk, Jl))
    num_l, num_f = r.shape[:2]
    of_anchor = jax.nn.one_hot(jnp.asarray(views.anchor), num_f, dtype=r.dtype)
    g = jnp.einsum("lfri,lfr->fi", Jk, r, precision=_HIGHEST)
    g += jnp.einsum("lg,lfri,lfr->gi", of_anchor, Ja, r, precision=_HIGHEST)
    between = jnp.einsum("lg,lfij->gfij", of_anchor, _gram(Ja, Jk), precision=_HIGHEST)
    own = jnp.sum(_gram(Jk, Jk), axis=0) + jnp.einsum("lg,lij->gij", of_anchor, jnp.sum(_gram(Ja, Ja), axis=1))
    H = between + between.transpose(1, 0, 3, 2)
    H = H.at[jnp.arange(num_f), jnp.arange(num_f)].add(own)
    across = _gram(Jk, Jl) + of_anchor[:, :, None, None] * jnp.sum(_gram(Ja, Jl), axis=1)[:, None]
    is_used = jnp.any(jnp.asarray(views.sqrt_info) > 0, axis=1)
    landmark = jnp.sum(_gram(Jl, Jl), axis=1)
    # Inverse depths of points that show no parallax stay where they are: a prior far beyond what any road holds.
    weak = jnp.diag(jnp.asarray([1e-4, 1e-4, 1e-2], r.dtype))
    landmark += jnp.where(is_used[:, None, None], weak, jnp.eye(3, dtype=r.dtype))
    return _Seen(
        jnp.sum(cost),
        g,
        H.transpose(0, 2, 1, 3).reshape(6 * num_f, 6 * num_f),
        jnp.einsum("lfri,lfr->li", Jl, r, precision=_HIGHEST),
        landmark,
        across.reshape(num_l, 6 * num_f, 3),
    )


def _gram(A: Array, B: Array) -> Array:
    return jnp.einsum("lfri,lfrj->lfij", A, B, precision=_HIGHEST)


def _kept_from_zero(r: Array) -> Array:
    # The norm has no derivative at zero; nobody asks for one, but NaN must not appear.
    return jnp.where(jnp.any(r != 0), r, 1e-12)


def _inertial(
    T_from: Array, v_from: Array, bias: Array, T_to: Array, v_to: Array, steps: Preintegrated, sqrt_info: Array
) -> Float[Array, "9"]:
    gravity = jnp.asarray(GRAVITY_MAP, T_from.dtype)
    return imu_residual(InertialState(T_from, v_from), InertialState(T_to, v_to), bias, gravity, steps, sqrt_info)


def _still(T_from: Array, T_to: Array, sqrt_info: Array) -> Float[Array, "6"]:
    return between_residual(T_from, T_to, jnp.eye(4, dtype=T_from.dtype), sqrt_info)
