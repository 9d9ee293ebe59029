"""The one front of all graph solves (room: solvers; host around JAX).

In: a FactorGraph and start values, how its normal equations are structured. Out: Solution.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx

from semloc_jax.solvers.arrow import ArrowProblem, arrow_problem
from semloc_jax.solvers.dense import DenseProblem
from semloc_jax.solvers.graph import FactorGraph, Values
from semloc_jax.solvers.levenberg_marquardt import SolveConfig, levenberg_marquardt_on_host
from semloc_jax.solvers.problem import LeastSquaresProblem, Solution


@dataclass(frozen=True)
class Dense:
    """One full matrix: tens of variables of any shape."""


@dataclass(frozen=True)
class Arrow:
    """A chain in time with few shared unknowns: cost grows with its length."""

    chain: tuple[str, ...]
    """Families whose variables of equal place are one link."""


@dataclass(frozen=True)
class Sparse:
    """Any graph of thousands of variables, factorised by the host: not inside jit, in float64."""

    first: tuple[str, ...] = ()
    """Families that are eliminated first, such as landmarks: no factor binds two of their variables."""


Structure = Dense | Arrow | Sparse


def structured(graph: FactorGraph, structure: Structure) -> LeastSquaresProblem:
    """The graph as a problem with normal equations of one structure."""
    if isinstance(structure, Sparse):
        from semloc_jax.solvers.sparse import SparseProblem

        return SparseProblem(graph, structure.first)
    return arrow_problem(graph, structure.chain) if isinstance(structure, Arrow) else DenseProblem(graph)


def solve(
    problem: FactorGraph | LeastSquaresProblem,
    start: Values | Any,
    config: SolveConfig | None = None,
    structure: Structure | None = None,
) -> Solution:
    """The most likely values near a start, by Levenberg-Marquardt.

    Dense and arrow problems may be solved inside jit and vmap, sparse ones not. Failures are data: see
    `Solution.status`.

    Args:
        problem: A factor graph, or a problem that brings its own normal equations.
        start: Start values.
        config: None for the defaults.
        structure: Of the normal equations of a graph; None: dense.
    """
    config = config or SolveConfig()
    if isinstance(problem, FactorGraph):
        problem = structured(problem, structure or Dense())
    if getattr(problem, "is_led_by_host", False):
        return levenberg_marquardt_on_host(problem, start, config)
    if isinstance(problem, DenseProblem | ArrowProblem):
        return _compiled(problem, start, config)
    return _in_one_program(problem, start, config)


def _in_one_program(problem: LeastSquaresProblem, start: Any, config: SolveConfig) -> Solution:
    from semloc_jax.solvers.optimistix_loop import levenberg_marquardt

    return levenberg_marquardt(problem, start, config)


_compiled = eqx.filter_jit(_in_one_program)
"""Graphs are also solved outside of jit; those of equal shapes then share one program."""
