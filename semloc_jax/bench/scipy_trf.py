"""scipy.optimize.least_squares, trust region reflective (room: bench).

In: a Problem. Out: poses. Residual and Jacobian are the package's, compiled; the variant says whether scipy is given
the Jacobian or takes finite differences.
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from semloc_jax.alignment.pose import level_problem, visible_views
from semloc_jax.alignment.problem import pose_of, residual
from semloc_jax.bench.host_model import coarse_to_fine
from semloc_jax.bench.ours import config_of, evidence_of
from semloc_jax.bench.peer import Solved
from semloc_jax.bench.problem import Problem

SHIFT = np.full(6, 10.0)
"""scipy scales xtol and its difference steps by the unknown; far from zero both are what they say."""


def create(variant: str) -> "ScipyPeer":
    """`2-point` or `jacobian`."""
    return ScipyPeer(variant)


class ScipyPeer:
    """One start after another."""

    def __init__(self, variant: str) -> None:
        self.by_differences = variant == "2-point"

    def load(self, problem: Problem) -> None:
        """Compiled residual, Jacobian and chart."""
        self.problem = problem
        evidence, prior = evidence_of(problem)
        config = config_of("xla")

        @jax.jit
        def at_level(T, level):
            views = visible_views(T, evidence, problem.border_px)
            return level_problem(T, views, level, evidence, prior, config)

        self._at_level, self._pose = at_level, jax.jit(pose_of)
        self._residual = jax.jit(residual)
        self._jacobian = jax.jit(jax.jacfwd(residual))

    def solve(self, Ts_init: np.ndarray, levels: tuple[int, ...]) -> Solved:
        """All starts through all levels."""
        return coarse_to_fine(Ts_init, levels, self._solve_level)

    def _solve_level(self, T: np.ndarray, level: int) -> tuple[np.ndarray, int]:
        at_level = self._at_level(jnp.asarray(T, jnp.float32), level)
        calls = 0

        def fun(z):
            nonlocal calls
            calls += 1
            return np.asarray(self._residual(np.float32(z - SHIFT), at_level), np.float64)

        def jac(z):
            return np.asarray(self._jacobian(np.float32(z - SHIFT), at_level), np.float64)

        how = {"jac": "2-point", "diff_step": 1e-4} if self.by_differences else {"jac": jac}
        xtol = self.problem.tolerance / np.linalg.norm(SHIFT)
        limit = {"xtol": xtol, "ftol": None, "gtol": None, "max_nfev": self.problem.max_steps}
        found = least_squares(fun, SHIFT, method="trf", **how, **limit)
        return np.asarray(self._pose(np.float32(found.x - SHIFT), at_level), np.float64), calls
