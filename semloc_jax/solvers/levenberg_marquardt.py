"""The one Levenberg-Marquardt, as an optimistix solver (room: solvers; pure JAX).

In: a LeastSquaresProblem and a start. Out: Solution, or the state after each step.
Optimistix leads the loop; we bring evaluation, steps on a manifold and the damping. Its own solver carries the whole
Jacobian through the loop and, under vmap, selects over it at every step.
Madsen, Nielsen, Tingleff, Methods for Non-Linear Least Squares Problems, 2004, ch. 3.2. A step is judged by the fall of
the cost as a share of what the quadratic model promised; refused steps are repeated shorter.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.solvers.problem import LeastSquaresProblem, Solution, Step
from semloc_jax.structs import SolveStatus

_LEAST_FALL = 0.01
"""A step is accepted when the cost falls by this share of the promise (Nocedal, Wright, Numerical Optimization, 4)."""
_LEAST_DAMPING, _MOST_DAMPING = 1e-12, 1e12
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
    accept = is_first | (change <= _LEAST_FALL * state.change)
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
        damping=jnp.clip(state.damping * factor, _LEAST_DAMPING, _MOST_DAMPING).astype(state.damping.dtype),
        num_steps=state.num_steps + 1,
        num_accepted=state.num_accepted + accept,
        status=status,
    )


def proposed(problem: LeastSquaresProblem, state: Iterate, step: Step) -> Iterate:
    """The state with the candidate that a `Step` leads to."""
    candidate = problem.retract(state.value, step.tangent)
    return eqx.tree_at(lambda s: (s.candidate, s.change, s.length), state, (candidate, step.change, step.length))


def advance(problem: LeastSquaresProblem, state: Iterate, config: SolveConfig) -> Iterate:
    """One evaluation: judge the candidate, then propose the next."""
    state = judged(state, problem.linearise(state.candidate, state.ended), config)
    return proposed(problem, state, problem.step(state.equations, state.damping))


class LevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """`begin` and `advance` for `optimistix.least_squares`.

    `args` is the LeastSquaresProblem and `options["start"]` the start. The value lies on a manifold and stays in the
    state; optimistix, whose values are vectors, is given a zero in its place.
    """

    config: SolveConfig
    atol: float
    rtol: float = 0.0
    norm: Callable[[Any], Array] = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        """State before the first evaluation."""
        return begin(args, options["start"], self.config)

    def step(self, fn, y, args, options, state, tags):
        """One evaluation: judge the candidate, then propose the next."""
        return y, advance(args, state, self.config), None

    def terminate(self, fn, y, args, options, state, tags):
        """Whether nothing is left to do; how it ended is in the status of the state."""
        return state.ended, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        """The solution with the last state."""
        return y, aux, {"state": state}


class _ForwardOnly(optx.AbstractAdjoint):
    """A plain loop: reverse-mode derivatives through it are refused by JAX, not wrong (see `solvers.implicit`)."""

    def apply(self, primal_fn, rewrite_fn, inputs, tags):
        """The solution, without a rule for its derivatives."""
        return primal_fn((*inputs, _while_loop))


def _while_loop(is_going: Callable, body: Callable, start: Any, *, max_steps: int) -> Any:
    """`jax.lax.while_loop` of at most `max_steps` rounds."""

    def goes_on(carry: tuple) -> Bool[Array, ""]:
        return is_going(carry[1]) & (carry[0] < max_steps)

    return jax.lax.while_loop(goes_on, lambda carry: (carry[0] + 1, body(carry[1])), (jnp.asarray(0), start))[1]


def levenberg_marquardt(problem: LeastSquaresProblem, start: Any, config: SolveConfig) -> Solution:
    """The best value near a start; may be jitted and vmapped. Reverse-mode derivatives: see `solvers.implicit`."""
    found = optx.least_squares(
        lambda nothing, problem: nothing,  # asked for, never evaluated: the problem linearises itself
        LevenbergMarquardt(config, config.tolerance),
        jnp.zeros(()),
        args=problem,
        options={"start": start},
        max_steps=config.max_steps,
        adjoint=_ForwardOnly(),
        throw=False,
    )
    end = found.stats["state"]
    return Solution(end.value, end.equations, end.num_steps, end.status)


def levenberg_marquardt_on_host(problem: LeastSquaresProblem, start: Any, config: SolveConfig) -> Solution:
    """The same loop, led by the host, for a problem whose steps JAX cannot take (sparse factorisation); not inside jit.

    The problem compiles its own methods.
    """
    state = begin(problem, start, config)
    while not bool(state.ended) and int(state.num_steps) < config.max_steps:
        state = _judged(state, problem.linearise(state.candidate, state.ended), config)
        if not bool(state.ended):
            state = proposed(problem, state, problem.step(state.equations, state.damping))
    return Solution(state.value, state.equations, state.num_steps, state.status)


_judged = eqx.filter_jit(judged)


def _chosen(accept: Bool[Array, ""], new: Any, old: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(accept, a, b), new, old)


def _is_finite(value: Any) -> Bool[Array, ""]:
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(value)]))
