"""Levenberg-Marquardt on block-arrow normal equations, as an optimistix solver (room: solvers; pure JAX).

In: a problem that can `linearise` itself at a state and `move` a state. Out: what optimistix.least_squares returns.
Poses are eliminated at every step; a step is accepted when the cost falls.
"""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from semloc_jax.solvers.arrow import ArrowEquations, step

TANGENT_UNIT = np.array([0.5, 0.5, 0.5, 0.05, 0.05, 0.05])
"""Scale of the damping of a pose [m, rad]; ours. Shared unknowns come in units of their priors."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-9, 1e9
_FREE_DAMPING = 0.1
"""Below this damping a step is as long as the model wants it."""


@runtime_checkable
class ArrowProblem(Protocol):
    """What can be solved: a cost with poses in a chain and shared unknowns."""

    def linearise(self, state: Any) -> ArrowEquations:
        """Normal equations at a state, shared unknowns in units of their priors."""

    def move(self, state: Any, poses: Float[Array, "n 6"], shared: Float[Array, " s"]) -> Any:
        """The state after a step in right tangents and in units of the priors."""

    def residuals(self, state: Any) -> Float[Array, " m"]:
        """Whitened residuals; half their squared norm is the cost that `linearise` gives."""


class _State(eqx.Module):
    candidate: Any
    length: Float[Array, ""]
    damping: Float[Array, ""]
    equations: ArrowEquations
    first: Bool[Array, ""]
    converged: Bool[Array, ""]


class ArrowLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt on a manifold: every evaluation is `linearise` at the candidate, in its own chart.

    A solve ends when an accepted step is below `atol` in units of `TANGENT_UNIT` and of the priors, or when a free step
    gains less than `gain_nats`: it then moved everything by a small share of its sigma.
    """

    atol: float
    gain_nats: float = 3e-3
    rtol: float = 0.0
    norm: Callable[[Any], Array] = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        """State before the first evaluation."""
        shapes = jax.eval_shape(lambda: args.linearise(y))
        zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
        zero = zeros.cost
        return _State(y, zero, zero + _FIRST_DAMPING, zeros, jnp.array(True), jnp.array(False))

    def step(self, fn, y, args, options, state, tags):
        """One evaluation: judge the candidate, then propose the next."""
        equations = args.linearise(state.candidate)
        worst = state.equations.cost * (1 + 1e-12) + 1e-9
        accept = state.first | (equations.cost <= worst)
        small = (state.equations.cost - equations.cost < self.gain_nats) & (state.damping < _FREE_DAMPING)
        y, equations = jax.tree.map(
            lambda new, old: jnp.where(accept, new, old), (state.candidate, equations), (y, state.equations)
        )
        damping = jnp.where(accept, 0.1 * state.damping, 10.0 * state.damping)
        damping = jnp.clip(damping, _LEAST_DAMPING, _MOST_DAMPING)
        unit = jnp.asarray(TANGENT_UNIT, damping.dtype)
        poses, shared = step(equations.damped(damping / unit**2, jnp.full(equations.shared.shape[0], damping)))
        converged = accept & ~state.first & ((state.length < self.atol) | small)
        length = jnp.maximum(self.norm(poses / unit), self.norm(shared)) if poses.size else self.norm(shared)
        moved = args.move(y, poses, shared)
        return y, _State(moved, length, damping, equations, jnp.array(False), converged), None

    def terminate(self, fn, y, args, options, state, tags):
        """Whether the last accepted step was small."""
        return state.converged, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        """The solution with its normal equations."""
        return y, aux, {"equations": state.equations}


def solve_arrow(
    problem: ArrowProblem, start: Any, tolerance: float, max_steps: int
) -> tuple[Any, ArrowEquations, Array, Array]:
    """Best state, the normal equations there, evaluations spent and whether the solve converged."""
    solution = optx.least_squares(
        lambda y, args: args.residuals(y),
        ArrowLevenbergMarquardt(atol=tolerance),
        start,
        args=problem,
        max_steps=max_steps,
        throw=False,
    )
    converged = solution.result == optx.RESULTS.successful
    return solution.value, solution.stats["equations"], solution.stats["num_steps"], converged
