"""jaxopt's LevenbergMarquardt, vmapped (room: bench).

In: a Problem. Out: poses. The residual is the package's own fast one; only the solver differs.
"""

import warnings

import jax
import jax.numpy as jnp

from semloc_jax.alignment.problem import residual
from semloc_jax.bench.optimistix_lm import VmappedPeer


def create(_: str) -> VmappedPeer:
    """jaxopt, one program for all starts."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the package is no longer developed
        from jaxopt import LevenbergMarquardt

    def solve_level(problem, max_steps: int, tolerance: float):
        solver = LevenbergMarquardt(residual, maxiter=max_steps, materialize_jac=True, solver="cholesky")
        y = jnp.zeros(6, problem.T_start.dtype)

        def is_moving(carry):
            # Its own test is relative to the unknown, which is near zero on the last level; this one is everybody's.
            _, state = carry
            step = jnp.max(jnp.abs(state.delta))
            return (state.iter_num < max_steps) & ((state.iter_num == 0) | (step >= tolerance))

        def step(carry):
            return tuple(solver.update(carry[0], carry[1], problem))

        y, state = jax.lax.while_loop(is_moving, step, (y, solver.init_state(y, problem)))
        return y, state.iter_num

    return VmappedPeer(solve_level)
