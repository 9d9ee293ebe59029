"""optimistix as its documentation shows it: LevenbergMarquardt on a residual function, vmapped (room: bench).

In: a Problem. Out: poses. The residual is the package's own fast one; only the solver differs.
"""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from semloc_jax.alignment.pose import level_problem, visible_views
from semloc_jax.alignment.problem import pose_of, residual
from semloc_jax.bench.ours import config_of, evidence_of, levels_on_device
from semloc_jax.bench.peer import Solved
from semloc_jax.bench.problem import Problem

RTOL = 1e-3
"""Its test also bounds the change of the cost; at this share of the cost that bound is not the tighter one."""


def create(_: str) -> "VmappedPeer":
    """optimistix, one program for all starts."""

    def solve_level(problem, max_steps: int, tolerance: float):
        solver = optx.LevenbergMarquardt(rtol=RTOL, atol=tolerance)
        y0 = jnp.zeros(6, problem.T_start.dtype)
        solution = optx.least_squares(residual, solver, y0, args=problem, max_steps=max_steps, throw=False)
        return solution.value, solution.stats["num_steps"]

    return VmappedPeer(solve_level)


class VmappedPeer:
    """A JAX solver of one level, chained over levels and vmapped over starts."""

    def __init__(self, solve_level) -> None:
        self.solve_level = solve_level

    def load(self, problem: Problem) -> None:
        """The package's containers, and one compiled function for all starts."""
        evidence, prior = evidence_of(problem)
        config = config_of("xla")

        def one(T, levels):
            def one_level(T, level):
                views = visible_views(T, evidence, problem.border_px)
                at_level = level_problem(T, views, level, evidence, prior, config)
                y, num_steps = self.solve_level(at_level, problem.max_steps, problem.tolerance)
                return pose_of(y, at_level), num_steps

            T, num_steps = jax.lax.scan(one_level, T, levels)
            return T, jnp.sum(num_steps)

        self._solve = jax.jit(jax.vmap(one, in_axes=(0, None)))

    def solve(self, Ts_init: np.ndarray, levels: tuple[int, ...]) -> Solved:
        """All starts side by side."""
        Ts, num_steps = map(np.asarray, self._solve(Ts_init.astype(np.float32), levels_on_device(levels)))
        return Solved(Ts, num_steps.sum() / len(Ts))
