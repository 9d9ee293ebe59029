"""Levenberg-Marquardt as an optimistix solver (room: solvers; pure JAX).

In: a LeastSquaresProblem and a start. Out: Solution.
Optimistix leads the loop; we bring evaluation, steps on a manifold and the damping. Its own solver carries the whole
Jacobian through the loop and, under vmap, selects over it at every step. Loaded when a solve is traced: optimistix is a
tenth of all imports, and a process whose programs are kept does without.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool

from semloc_jax.solvers.levenberg_marquardt import SolveConfig, advance, begin
from semloc_jax.solvers.problem import LeastSquaresProblem, Solution


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
