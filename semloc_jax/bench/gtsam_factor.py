"""gtsam's Levenberg-Marquardt on one CustomFactor with a numpy Jacobian (room: bench).

In: a Problem. Out: poses. The unknown is the tangent of the level in units of the prior, as for every other peer.
"""

import numpy as np

from semloc_jax.bench.host_model import LevelModel, coarse_to_fine
from semloc_jax.bench.peer import Solved
from semloc_jax.bench.problem import Problem


def create(_: str) -> "GtsamPeer":
    """gtsam, one graph of one factor for each level."""
    return GtsamPeer()


class GtsamPeer:
    """One start after another."""

    def __init__(self) -> None:
        import gtsam

        self.gtsam = gtsam

    def load(self, problem: Problem) -> None:
        """Keep the arrays."""
        self.problem = problem

    def solve(self, Ts_init: np.ndarray, levels: tuple[int, ...]) -> Solved:
        """All starts through all levels."""
        return coarse_to_fine(Ts_init, levels, self._solve_level)

    def _solve_level(self, T: np.ndarray, level: int) -> tuple[np.ndarray, int]:
        gtsam, model = self.gtsam, LevelModel(self.problem, level, T)
        evaluations = 0

        def error(this, values, jacobians):
            nonlocal evaluations
            y = values.atVector(this.keys()[0])
            if jacobians is None:
                return model.residual(y)
            evaluations += 1
            residuals, jacobians[0] = model.residual_and_jacobian(y)
            return residuals

        num = self.problem.p_map.shape[1] + 6
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(num), [0], error))
        values.insert(0, np.zeros(6))
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values)
        y = np.zeros(6)
        # Its own test is on the cost; this one is everybody's.
        for _ in range(self.problem.max_steps):
            optimizer.iterate()
            before, y = y, optimizer.values().atVector(0)
            if np.abs(y - before).max() < self.problem.tolerance:
                break
        return model.pose(y), evaluations
