"""Factors of which some are plainly wrong, such as false loops: graduated non-convexity (room: solvers; host).

In: a FactorGraph, which of its families are doubtful. Out: Solution and a weight in [0, 1] for every doubtful factor.
Yang, Antonante, Tzoumas, Carlone, Graduated Non-Convexity for Robust Spatial Perception, RA-L 2020: truncated least
squares, eqs. (11)-(14). A robust loss only bends the cost; this lets go of what does not fit, whatever it pulls.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.errors import SemlocError
from semloc_jax.solvers.factors import Factors, costs_of
from semloc_jax.solvers.front import Dense, Structure, solve, structured
from semloc_jax.solvers.graph import FactorGraph, Values
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.solvers.problem import Solution


@dataclass(frozen=True)
class GncConfig:
    """How wrong factors are found. The factor is that of the paper, the rest is ours."""

    limit_nats: float
    """Cost beyond which a factor is wrong: half the quantile of chi-square with as many numbers as it has."""
    factor: float = 1.4
    """The cost becomes less convex by this factor from one solve to the next."""
    max_rounds: int = 60
    solve: SolveConfig = field(default_factory=SolveConfig)


class GncSolution(NamedTuple):
    """The solution without what is wrong."""

    solution: Solution
    weights: dict[int, Float[np.ndarray, " f"]]
    """By place of the family in `FactorGraph.factors`: 1 for factors that are kept, 0 for those that are wrong."""
    num_rounds: int


def solve_robustly(
    graph: FactorGraph, start: Values, doubtful: tuple[int, ...], config: GncConfig, structure: Structure | None = None
) -> GncSolution:
    """The most likely values when some factors of the doubtful families are wrong.

    Args:
        graph: Its other families are trusted.
        start: Start values.
        doubtful: Places of families in `graph.factors`; they have no robust function and no weight of their own.
        config: What counts as wrong.
        structure: As `solve`.

    Raises:
        SemlocError: A doubtful family has a robust function or weights.
    """
    _check(graph, doubtful)
    problem = structured(graph, structure or Dense())
    weights = {place: np.ones(graph.factors[place].sqrt_info.shape[0]) for place in doubtful}
    solution = solve(problem.of(_weighted(graph, weights)), start, config.solve)
    costs = _costs(graph, solution.value, doubtful)
    worst = max((float(cost.max(initial=0.0)) for cost in costs.values()), default=0.0)
    # Convex at first: the worst factor still counts.
    control = config.limit_nats / max(2 * worst - config.limit_nats, 1e-12)
    num_rounds = 0
    while worst > config.limit_nats and num_rounds < config.max_rounds:
        num_rounds += 1
        weights = {place: _weight(cost, control, config.limit_nats) for place, cost in costs.items()}
        solution = solve(problem.of(_weighted(graph, weights)), solution.value, config.solve)
        costs = _costs(graph, solution.value, doubtful)
        if all(np.all((weight == 0) | (weight == 1)) for weight in weights.values()):
            break
        control *= config.factor
    return GncSolution(solution, weights, num_rounds)


def _check(graph: FactorGraph, doubtful: tuple[int, ...]) -> None:
    for place in doubtful:
        factors = graph.factors[place]
        if not isinstance(factors, Factors) or factors.robust is not None or factors.weight is not None:
            raise SemlocError(
                f"graduated non-convexity: family {place} on {factors.on} has a robust function or weights; expected "
                "plain factors, whose weights are found here"
            )


def _weight(cost: Float[np.ndarray, " f"], control: float, limit: float) -> Float[np.ndarray, " f"]:
    """Weight of truncated least squares that is convex at control 0 and truncated at infinity."""
    share = np.sqrt(limit / np.maximum(cost, 1e-300))
    between = share * np.sqrt(control * (control + 1)) - control
    low, high = limit * control / (control + 1), limit * (control + 1) / control
    return np.where(cost <= low, 1.0, np.where(cost >= high, 0.0, np.clip(between, 0.0, 1.0)))


def _weighted(graph: FactorGraph, weights: dict[int, np.ndarray]) -> FactorGraph:
    factors = list(graph.factors)
    for place, weight in weights.items():
        factors[place] = replace(factors[place], weight=weight)
    return replace(graph, factors=tuple(factors))


def _costs(graph: FactorGraph, values: Values, places: tuple[int, ...]) -> dict[int, np.ndarray]:
    return {place: np.asarray(costs_of(graph.factors[place], values)) for place in places}
