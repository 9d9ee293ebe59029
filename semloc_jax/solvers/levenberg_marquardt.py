"""The one Levenberg-Marquardt, step by step (room: solvers; pure JAX).

In: a LeastSquaresProblem and a start. Out: the state after each step; Solution where the host leads the loop.
Inside jit the loop is led by optimistix (`solvers.optimistix_loop`).
Madsen, Nielsen, Tingleff, Methods for Non-Linear Least Squares Problems, 2004, ch. 3.2. A step is judged by the fall of
the cost as a share of what the quadratic model promised; refused steps are repeated shorter.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.solvers.problem import LeastSquaresProblem, Solution, Step
from semloc_jax.structs import SolveStatus

LEAST_FALL = 0.01
"""A step is accepted when the cost falls by this share of the promise (Nocedal, Wright, Numerical Optimization, 4)."""
LEAST_DAMPING, MOST_DAMPING = 1e-12, 1e12
"""Bounds of the damping; so far any problem is solved or given up."""
_FREE_DAMPING = 0.1
"""Below this damping a step is as long as the model wants it."""


@dataclass(frozen=True)
class Damping:
    """How the damping follows the steps. The defaults are ours, for problems in units of metres and radians."""

    first: float = 1e-4
    good_fall: float = 0.25
    """Share of the promised fall beyond which the damping is eased."""
    ease: float = 0.1
    """Factor of the damping after a good step."""
    press: float = 10.0
    """Factor of the damping after a refused step."""


@dataclass(frozen=True)
class SolveConfig:
    """When a solve ends. All values are ours."""

    tolerance: float = 1e-3
    """A solve ends when a step is shorter than this; what its length is, the problem says: mostly the largest of its
    coordinates, in the units of the damping."""
    max_steps: int = 20
    """Most evaluations."""
    min_gain_nats: float = 0.0
    """A solve also ends when an accepted, hardly damped step gains less than this."""
    damping: Damping = Damping()
    takes_short: bool = False
    """A step below the tolerance is taken as it is, without an evaluation: the model is trusted so far. The equations
    of the solution are then those before it."""


class Iterate(eqx.Module):
    """State of the loop between two evaluations."""

    value: Any
    """The best value so far."""
    equations: Any
    """Normal equations there."""
    candidate: Any
    """What is evaluated next."""
    change: Float[Array, ""]
    """What the model promises of the candidate [nats]."""
    length: Float[Array, ""]
    """Length of the step to the candidate."""
    damping: Float[Array, ""]
    num_steps: Int[Array, ""]
    num_accepted: Int[Array, ""]
    status: Int[Array, ""]
    """MAX_STEPS while the loop goes on."""

    @property
    def ended(self) -> Bool[Array, ""]:
        """Whether nothing is left to do."""
        return self.status != SolveStatus.MAX_STEPS


def begin(problem: LeastSquaresProblem, start: Any, config: SolveConfig) -> Iterate:
    """State before the first evaluation, which is at the start."""
    start, is_going = jax.tree.map(jnp.asarray, start), jnp.asarray(False)
    shapes = eqx.filter_eval_shape(problem.linearise, start, is_going)
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    zero = jnp.zeros((), nothing.cost.dtype)
    first, none = zero + config.damping.first, jnp.asarray(0)
    going = jnp.asarray(int(SolveStatus.MAX_STEPS))
    return Iterate(start, nothing, start, zero, zero, first, none, none, going)


def judged(state: Iterate, equations: Any, config: SolveConfig) -> Iterate:
    """The state with the candidate accepted or refused, given its normal equations, and the next damping."""
    rule, is_first = config.damping, state.num_steps == 0
    change = equations.cost - state.equations.cost
    accept = is_first | (change <= LEAST_FALL * state.change)
    is_good = accept & ~is_first & (change < rule.good_fall * state.change)
    factor = jnp.where(accept, jnp.where(is_good, rule.ease, 1.0), rule.press)
    is_small = state.length < config.tolerance
    if config.min_gain_nats:
        is_small |= accept & (-change < config.min_gain_nats) & (state.damping < _FREE_DAMPING)
    value = _chosen(accept, state.candidate, state.value)
    status = jnp.where(is_small & ~is_first, SolveStatus.CONVERGED, SolveStatus.MAX_STEPS)
    status = jnp.where(_is_finite(value), status, SolveStatus.NOT_FINITE).astype(state.status.dtype)
    return Iterate(
        value=value,
        equations=_chosen(accept, equations, state.equations),
        candidate=value,
        change=state.change,
        length=state.length,
        damping=jnp.clip(state.damping * factor, LEAST_DAMPING, MOST_DAMPING).astype(state.damping.dtype),
        num_steps=state.num_steps + 1,
        num_accepted=state.num_accepted + accept,
        status=status,
    )


def proposed(problem: LeastSquaresProblem, state: Iterate, step: Step) -> Iterate:
    """The state with the candidate that a `Step` leads to."""
    candidate = problem.retract(state.value, step.tangent)
    return eqx.tree_at(lambda s: (s.candidate, s.change, s.length), state, (candidate, step.change, step.length))


def advance(problem: LeastSquaresProblem, state: Iterate, config: SolveConfig) -> Iterate:
    """One evaluation: judge the candidate, then propose the next, unless nothing is left to do."""
    state = judged(state, problem.linearise(state.candidate, state.ended), config)

    def next_of(state: Iterate) -> tuple:
        return _step_of(proposed(problem, state, problem.step(state.equations, state.damping)))

    # A step is half of an evaluation: the last one would be for nothing.
    step = jax.lax.cond(state.ended, _step_of, next_of, state)
    return settled(eqx.tree_at(_step_of, state, step), config)


def _step_of(state: Iterate) -> tuple:
    return state.candidate, state.change, state.length


def settled(state: Iterate, config: SolveConfig) -> Iterate:
    """The state at the end of a step so short that it is taken without being judged, where that is asked for."""
    if not config.takes_short:
        return state
    is_short = ~state.ended & (state.length < config.tolerance)
    cost = state.equations.cost + jnp.where(is_short, state.change, 0.0)
    status = jnp.where(is_short, int(SolveStatus.CONVERGED), state.status).astype(state.status.dtype)
    value = _chosen(is_short, state.candidate, state.value)
    return eqx.tree_at(lambda s: (s.value, s.equations.cost, s.status), state, (value, cost, status))


def levenberg_marquardt_on_host(problem: LeastSquaresProblem, start: Any, config: SolveConfig) -> Solution:
    """The same loop, led by the host, for a problem whose steps JAX cannot take (sparse factorisation); not inside jit.

    The problem compiles its own methods.
    """
    state = begin(problem, start, config)
    while not bool(state.ended) and int(state.num_steps) < config.max_steps:
        state = _judged(state, problem.linearise(state.candidate, state.ended), config)
        if not bool(state.ended):
            state = settled(proposed(problem, state, problem.step(state.equations, state.damping)), config)
    return Solution(state.value, state.equations, state.num_steps, state.status)


_judged = eqx.filter_jit(judged)


def _chosen(accept: Bool[Array, ""], new: Any, old: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(accept, a, b), new, old)


def _is_finite(value: Any) -> Bool[Array, ""]:
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(value)]))
