"""The cost of a window of inertial states and landmarks, and what is left when states go (room: fusion; pure JAX).

In: StateFactors (inertial sensor, vehicle, measured poses), Views of landmarks, WindowPrior. Out: WindowProblem for
the one solver; `left_by_oldest`: the prior that the oldest state leaves.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.fusion.inertial_prior import WindowPrior
from semloc_jax.fusion.inertial_sights import Views, seen_equations
from semloc_jax.fusion.inertial_states import families_of, unknowns_of
from semloc_jax.residuals.motion import between_residual, cauchy, pose_residual
from semloc_jax.residuals.preintegration import InertialState, Preintegrated, imu_residual
from semloc_jax.residuals.vehicle_motion import (
    change_residual,
    fading_residual,
    rolling_residual,
    standing_residual,
    wheel_speed_residual,
)
from semloc_jax.solvers.dense import DenseEquations, dense_hessian, marginal
from semloc_jax.solvers.factors import Factors
from semloc_jax.solvers.graph import FactorGraph, Steps, Values, split, units_of
from semloc_jax.solvers.problem import Step
from semloc_jax.solvers.schur import SchurEquations

GRAVITY_MAP = (0.0, 0.0, -9.81)
_HIGHEST = jax.lax.Precision.HIGHEST
LANDMARK_UNITS = (0.01, 0.01, 0.05)


class StateFactors(NamedTuple):
    """What sensors say of the states; `sqrt_info` 0 switches a factor off."""

    steps: Preintegrated | None
    """Of every interval, with a leading axis; None until they are integrated at the present biases."""
    inertial: Float[Array | np.ndarray, "e 9 9"]
    delay_s: Float[Array | np.ndarray, " e"]
    """How far the clock of the inertial sensor was taken to be ahead when `steps` were read from its log."""
    walk: dict[str, Float[Array | np.ndarray, "e k"]]
    """Of each family that changes slowly: 1 / standard deviation of its change."""
    bend_kept: Float[Array | np.ndarray, " e"]
    """Share of the bend of the road at one state that is left at the next."""
    bend: Float[Array | np.ndarray, "e 1"]
    """1 / standard deviation of what comes in its place."""
    rolling: Float[Array | np.ndarray, "f 2"]
    speed_mps: Float[Array | np.ndarray, " f"]
    wheels: Float[Array | np.ndarray, "f 1"]
    standing: Float[Array | np.ndarray, "f 3"]
    still: Float[Array | np.ndarray, "e 6 6"]
    """Of the motion of nothing between two states of a vehicle that stands."""
    T_measured: Float[Array | np.ndarray, "f 4 4"]
    measured: Float[Array | np.ndarray, "f 6 6"]


class WindowProblem(eqx.Module):
    """Cost over {pose, velocity, bias, scale, landmark}; see `LeastSquaresProblem`."""

    factors: StateFactors
    views: Views
    prior: WindowPrior
    threshold: float = eqx.field(static=True)
    """Of the whitened distance of a landmark beyond which its pull grows no more."""

    def linearise(self, value: Values, skip: Bool[Array, ""]) -> SchurEquations:
        """Normal equations; derivatives of touched states at their first estimates."""
        at = self.prior.slopes_at(value)
        graph = frame_graph(self.factors)
        local = graph.local(value, at)
        g = graph.gradients(local)
        gradient = jnp.concatenate([g[family.name].ravel() for family in graph.families])
        information = dense_hessian(graph, local, graph.families)
        cost = sum(jnp.sum(part.cost) for part in local)
        seen = seen_equations(self.views, value, at, self.threshold)
        num = len(seen.gradient)
        before = self.prior.equations(value)
        cost += seen.cost + before.cost
        gradient = (gradient + before.gradient).at[:num].add(seen.gradient)
        information = (information + before.information).at[:num, :num].add(seen.information)
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
        """The values after a step.

        Derivatives of held states are taken along the axes of their first estimates, so that is where they go: along
        their own axes a window that goes somewhere as a whole tore where states that are held meet others. Some
        milliradians between first and present attitude are 0.5 mm of 0.2 m, which inertial sensors know to 0.04 mm.
        """
        families = families_of(len(self.prior.touched))
        moved = {f.name: f.kind.retract(value[f.name], tangent[f.name]) for f in families}
        T, shift = jnp.asarray(value["pose"]), tangent["pose"][:, :3, None]
        p = T[:, :3, 3] + jnp.matmul(self.prior.slopes_at(value)["pose"][:, :3, :3], shift, precision=_HIGHEST)[..., 0]
        moved["pose"] = moved["pose"].at[:, :3, 3].set(p)
        return moved | {"landmark": value["landmark"] + tangent["landmark"]}


def frame_graph(factors: StateFactors) -> FactorGraph:
    """Everything but landmarks and prior."""
    num = len(factors.rolling)
    here, before = np.arange(num), np.arange(num - 1)
    after, robust = before + 1, cauchy(4.0)
    parts = (
        Factors(
            _inertial,
            ("pose", "velocity", "bias", "mount", "delay", "pose", "velocity"),
            (*(before,) * 5, after, after),
            (factors.steps, factors.delay_s),
            factors.inertial,
        ),
        *(
            Factors(change_residual, (name, name), (before, after), (), sqrt_info)
            for name, sqrt_info in factors.walk.items()
        ),
        Factors(fading_residual, ("bend", "bend"), (before, after), (factors.bend_kept,), factors.bend),
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
        walk={name: masked(sqrt_info, on_edge) for name, sqrt_info in factors.walk.items()},
        **{name: masked(getattr(factors, name), on_edge) for name in ("inertial", "still", "bend")},
        **{name: masked(getattr(factors, name), on_state) for name in ("rolling", "wheels", "standing", "measured")},
    )
    is_gone = jnp.asarray(problem.views.anchor) < num_gone
    views = problem.views._replace(
        sqrt_info=masked(problem.views.sqrt_info, is_gone), on_road=masked(problem.views.on_road, is_gone)
    )
    oldest = eqx.tree_at(lambda p: (p.factors, p.views), problem, (own, views))
    left = oldest.linearise(value, jnp.asarray(False)).reduced()
    return marginal(left, unknowns_of(np.arange(num_gone), num), unknowns_of(np.arange(num_gone, num), num))


def _inertial(
    T_from: Array,
    v_from: Array,
    bias: Array,
    mount: Array,
    delay: Array,
    T_to: Array,
    v_to: Array,
    steps: Preintegrated,
    delay_s: Array,
    sqrt_info: Array,
) -> Float[Array, "9"]:
    gravity, later_s = jnp.asarray(GRAVITY_MAP, T_from.dtype), delay[0] - delay_s
    start, end = InertialState(T_from, v_from), InertialState(T_to, v_to)
    return imu_residual(start, end, bias, gravity, steps, sqrt_info, mount, later_s)


def _still(T_from: Array, T_to: Array, sqrt_info: Array) -> Float[Array, "6"]:
    return between_residual(T_from, T_to, jnp.eye(4, dtype=T_from.dtype), sqrt_info)
