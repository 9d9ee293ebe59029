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

from semloc_jax.fusion.inertial_chain import chain_equations
from semloc_jax.fusion.inertial_prior import WindowPrior
from semloc_jax.fusion.inertial_sights import Views, seen_equations
from semloc_jax.fusion.inertial_states import families_of, unknowns_of
from semloc_jax.residuals.motion import between_linearised, between_residual, cauchy, pose_linearised, pose_residual
from semloc_jax.residuals.preintegration import InertialState, Preintegrated, imu_residual
from semloc_jax.residuals.vehicle_motion import (
    fading_linearised,
    fading_residual,
    rolling_residual,
    standing_residual,
    wheel_speed_residual,
)
from semloc_jax.solvers.dense import DenseEquations, marginal
from semloc_jax.solvers.factors import Factors
from semloc_jax.solvers.graph import FactorGraph, Steps, Values, split, units_of
from semloc_jax.solvers.problem import Step
from semloc_jax.solvers.schur import SchurEquations

GRAVITY_MAP = (0.0, 0.0, -9.81)
_HIGHEST = jax.lax.Precision.HIGHEST
LANDMARK_UNITS = (0.01, 0.01, 0.05)
SLOW = "height", "bend", "bias", "scale", "mount", "delay"
"""Families that change slowly."""


class StateFactors(NamedTuple):
    """What sensors say of the states; `sqrt_info` 0 switches a factor off."""

    steps: Preintegrated
    """Of every interval, with a leading axis."""
    inertial: Float[Array | np.ndarray, "e 9 9"]
    delay_s: Float[Array | np.ndarray, " e"]
    """How far the clock of the inertial sensor was taken to be ahead when `steps` were read from its log."""
    kept: Float[Array | np.ndarray, "e k"]
    """Share of what changes slowly, in the order of `SLOW`, that is left at the next state."""
    walk: Float[Array | np.ndarray, "e k"]
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
        seen = seen_equations(self.views, value, at, self.threshold)
        chain = chain_equations(frame_graph(self.factors), value, at, len(self.prior.touched))
        before, more = self.prior.equations(value), len(chain.gradient) - len(seen.gradient)
        return SchurEquations(
            chain.cost + before.cost + seen.cost,
            chain.gradient + before.gradient + jnp.pad(seen.gradient, (0, more)),
            chain.information + before.information + jnp.pad(seen.information, (0, more)),
            seen.landmark_gradient,
            seen.landmark,
            seen.across,
        )

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
    factors, num = jax.tree.map(jnp.asarray, factors), len(factors.inertial) + 1
    here, before = np.arange(len(factors.rolling)), np.arange(num - 1)
    after, robust = before + 1, cauchy(4.0)
    parts = (
        Factors(
            _inertial,
            ("pose", "velocity", "bias", "mount", "delay", "pose", "velocity"),
            (*(before,) * 5, after, after),
            (factors.steps, factors.delay_s),
            factors.inertial,
        ),
        Factors(
            _slow,
            (*SLOW, *SLOW),
            (*(before,) * len(SLOW), *(after,) * len(SLOW)),
            (factors.kept,),
            factors.walk,
            linearised=_slow_linearised,
        ),
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
        Factors(_still, ("pose", "pose"), (before, after), (), factors.still, linearised=_still_linearised),
        Factors(
            pose_residual,
            ("pose",),
            (here,),
            (factors.T_measured,),
            factors.measured,
            robust=robust,
            linearised=pose_linearised,
        ),
    )
    return FactorGraph(families_of(num), parts)


def left_by_oldest(problem: WindowProblem, value: Values, num_gone: int) -> DenseEquations:
    """What the oldest states and the landmarks first seen by them say of the others, with the prior, at the values.

    The unknowns are those of the other states, at their places in a window that is so many states shorter.
    """
    num = len(problem.prior.touched)
    own = StateFactors(*jax.tree.map(lambda rows: rows[:num_gone], tuple(problem.factors)))
    is_gone = jnp.asarray(problem.views.anchor) < num_gone
    oldest = eqx.tree_at(lambda p: (p.factors, p.views), problem, (own, problem.views.only(is_gone)))
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


def _slow(*arguments: Array) -> Float[Array, " k"]:
    return fading_residual(*_ends(arguments))


def _slow_linearised(*arguments: Array) -> tuple[Float[Array, " k"], Float[Array, "k k"], Float[Array, "k k"]]:
    return fading_linearised(*_ends(arguments))


def _ends(arguments: tuple[Array, ...]) -> tuple[Array, Array, Array, Array]:
    """All that changes slowly at the start and at the end, then the rest of the arguments."""
    *states, kept, sqrt_info = arguments
    start, end = (jnp.concatenate(part) for part in (states[: len(SLOW)], states[len(SLOW) :]))
    return start, end, kept, sqrt_info


def _still(T_from: Array, T_to: Array, sqrt_info: Array) -> Float[Array, "6"]:
    return between_residual(T_from, T_to, jnp.eye(4, dtype=T_from.dtype), sqrt_info)


def _still_linearised(T_from: Array, T_to: Array, sqrt_info: Array) -> tuple[Array, Array, Array]:
    return between_linearised(T_from, T_to, jnp.eye(4, dtype=T_from.dtype), sqrt_info)
