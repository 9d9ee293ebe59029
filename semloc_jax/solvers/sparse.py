"""Sparse normal equations: thousands of variables with loops and landmarks (room: solvers; host around JAX).

In: a FactorGraph. Out: SparseProblem: blocks by JAX, factorisation by SuperLU with a fill-reducing order of the blocks.
Families that are eliminated first, such as landmarks, leave a Schur complement on the others before anything is
factorised.
"""

from collections.abc import Callable
from copy import copy
from itertools import combinations_with_replacement
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse.linalg import splu

from semloc_jax.errors import SemlocError
from semloc_jax.solvers.graph import FactorGraph, Steps, Values, split, units_of
from semloc_jax.solvers.problem import Step


class SparseEquations(eqx.Module):
    """Quadratic model; the information as its nonzero blocks, one after another, as `SparsePattern` places them."""

    cost: Float[Array, ""]
    gradient: Float[Array, " d"]
    entries: Float[Array, " e"]


class SparsePattern(NamedTuple):
    """Where the blocks of a graph stand; a block and its transpose are stored once."""

    starts: tuple[Int[np.ndarray, " f"], ...]
    """Where the block of every factor begins in `entries`, in the order of `FactorGraph.blocks(upper=True)`."""
    num_entries: int
    """Room for all blocks, rounded up: a loop more does not make another program."""
    diagonal: Int[np.ndarray, " d"]
    """Place of every coordinate's own entry."""
    order: Int[np.ndarray, " d"]
    """Coordinates in the order of elimination, families that go first in front."""
    matrix: sp.csc_array
    """The full matrix in that order; its values are the places of its entries."""
    num_first: int
    """Coordinates that are eliminated before the factorisation."""
    block_first: int
    """Coordinates of one of their variables."""


class SparseProblem:
    """A factor graph with sparse normal equations; see `LeastSquaresProblem`.

    Its steps are taken by the host: not inside jit.
    """

    is_led_by_host = True

    def __init__(self, graph: FactorGraph, first: tuple[str, ...] = ()) -> None:
        """Analyse the graph: order of elimination, place of every block.

        Args:
            graph: Its keys are concrete.
            first: Families that are eliminated first. No factor binds two of their variables.
        """
        self.graph = jax.tree.map(jnp.asarray, graph)
        self.pattern = _pattern(graph, first)
        self._starts = tuple(jnp.asarray(start) for start in self.pattern.starts)
        self._diagonal = jnp.asarray(self.pattern.diagonal)
        self._units = units_of(graph.families)

    def of(self, graph: FactorGraph) -> "SparseProblem":
        """The same for other data on the same variables: nothing is analysed again."""
        other = copy(self)
        other.graph = jax.tree.map(jnp.asarray, graph)
        return other

    def linearise(self, value: Values, skip: Bool[Array, ""]) -> SparseEquations:
        """Normal equations at the values."""
        return _assembled(self.graph, value, self._starts, self._diagonal, self.pattern.num_entries)

    def step(self, equations: SparseEquations, damping: Float[Array, ""]) -> Step:
        """The damped step of every variable."""
        g, more = np.asarray(equations.gradient, np.float64), float(damping) / self._units**2
        x = -self.solver(equations, more)(g)
        # (H + damping) x = -g gives x H x = -g x - damping x x.
        change, length = 0.5 * (g @ x - x @ (more * x)), np.max(np.abs(x) / self._units)
        dtype = equations.gradient.dtype
        steps = split(jnp.asarray(x, dtype), self.graph.families)
        return Step(steps, jnp.asarray(change, dtype), jnp.asarray(length, dtype))

    def retract(self, value: Values, tangent: Steps) -> Values:
        """The values after a step."""
        return _retracted(self.graph, value, tangent)

    def covariance(self, equations: SparseEquations, of: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
        """Joint covariance of the named coordinates, all others unknown."""
        wanted = np.zeros((len(self._units), len(of)))
        wanted[of, np.arange(len(of))] = 1.0
        return self.solver(equations, np.zeros(len(self._units)))(wanted)[of]

    def solver(self, equations: SparseEquations, more: Float[np.ndarray, " d"]) -> Callable[[np.ndarray], np.ndarray]:
        """Function x = (H + diag(more))^-1 b of b, a vector or columns; NaN where the matrix is singular."""
        pattern = self.pattern
        entries = np.asarray(equations.entries, np.float64).copy()
        entries[pattern.diagonal] += more
        matrix = sp.csc_array((entries[pattern.matrix.data], pattern.matrix.indices, pattern.matrix.indptr))
        try:
            solve = _factorised(matrix, pattern.num_first, pattern.block_first)
        except (RuntimeError, np.linalg.LinAlgError):  # exactly singular
            return lambda b: np.full_like(b, np.nan)

        def solved(b: np.ndarray) -> np.ndarray:
            x = np.empty_like(b)
            x[pattern.order] = solve(b[pattern.order])
            return x

        return solved


@eqx.filter_jit
def _assembled(
    graph: FactorGraph, value: Values, starts: tuple[Array, ...], diagonal: Array, num_entries: int
) -> SparseEquations:
    local = graph.local(value)
    entries = jnp.zeros(num_entries, local[0].hessian.dtype)
    place = {family.name: index for index, family in enumerate(graph.families)}
    for block, start in zip(graph.blocks(local, upper=True), starts, strict=True):
        hessian, turned = block.hessian, block.hessian.swapaxes(1, 2)
        if place[block.rows] > place[block.columns]:
            hessian = turned
        elif block.rows == block.columns:
            hessian = jnp.where((block.row_key > block.column_key)[:, None, None], turned, hessian)
        within = np.arange(hessian[0].size).reshape(hessian.shape[1:])
        entries = entries.at[start[:, None, None] + within].add(hessian)
    held = jnp.concatenate([jnp.asarray(graph.held(family.name)).ravel() for family in graph.families])
    g = graph.gradients(local)
    gradient = jnp.concatenate([g[family.name].ravel() for family in graph.families])
    return SparseEquations(
        sum(jnp.sum(part.cost) for part in local), gradient, entries.at[diagonal].add(held.astype(entries.dtype))
    )


@eqx.filter_jit
def _retracted(graph: FactorGraph, value: Values, tangent: Steps) -> Values:
    return graph.retract(value, tangent)


def _pattern(graph: FactorGraph, first: tuple[str, ...]) -> SparsePattern:
    """Symbolic analysis: which blocks there are, where they are stored, and the order of elimination."""
    sizes = np.concatenate([np.full(family.num, family.kind.size) for family in graph.families])
    base = dict(zip((f.name for f in graph.families), np.cumsum([0] + [f.num for f in graph.families]), strict=False))
    num = len(sizes)
    pairs = []
    for factors in graph.factors:
        ids = [base[name] + np.asarray(key) for name, key in zip(factors.on, factors.keys, strict=True)]
        for (a, i), (b, j) in combinations_with_replacement(enumerate(ids), 2):
            if a != b and (i == j).any():
                raise SemlocError(f"sparse graph: a factor on {factors.on} binds one variable twice; expected two")
            pairs.append(np.minimum(i, j) * num + np.maximum(i, j))
    own = np.arange(num) * (num + 1)
    codes = np.unique(np.concatenate([own, *pairs]))
    low, high = codes // num, codes % num
    starts = np.concatenate([[0], np.cumsum(sizes[low] * sizes[high])])
    diagonal = np.repeat(starts[np.searchsorted(codes, own)], sizes) + _within(sizes) * (np.repeat(sizes, sizes) + 1)
    is_first = np.concatenate([np.full(family.num, family.name in first) for family in graph.families])
    order = _order(low, high, is_first)
    offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    coordinates = np.repeat(offsets[order], sizes[order]) + _within(sizes[order])
    first_sizes = set(sizes[is_first].tolist())
    if len(first_sizes) > 1:
        raise SemlocError(f"sparse graph: families {first} have sizes {first_sizes}; expected one size to go first")
    return SparsePattern(
        starts=tuple(starts[np.searchsorted(codes, pair)].astype(np.int32) for pair in pairs),
        num_entries=_rounded_up(int(starts[-1])),
        diagonal=diagonal.astype(np.int32),
        order=coordinates,
        matrix=_matrix(low, high, starts, sizes, offsets, coordinates),
        num_first=int(np.sum(sizes[is_first])),
        block_first=first_sizes.pop() if first_sizes else 1,
    )


def _rounded_up(num: int) -> int:
    """The next of eight sizes in each octave, so that few programs serve graphs that grow."""
    step = 1 << max(num.bit_length() - 4, 0)
    return -(-num // step) * step


def _within(sizes: Int[np.ndarray, " n"]) -> Int[np.ndarray, " d"]:
    """0, 1 .. size - 1 of every variable."""
    return np.arange(np.sum(sizes)) - np.repeat(np.cumsum(sizes) - sizes, sizes)


def _order(low: np.ndarray, high: np.ndarray, is_first: Bool[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Variables in the order of elimination: those that go first, then the others by multiple minimum degree."""
    num = len(is_first)
    pattern = sp.coo_array((np.ones(len(low)), (low, high)), shape=(num, num)).tocsr()
    pattern = pattern + pattern.T
    front, rest = np.flatnonzero(is_first), np.flatnonzero(~is_first)
    if pattern[front][:, front].nnz > len(front):
        raise SemlocError("sparse graph: a factor binds two variables that go first; expected them to be independent")
    across = pattern[rest][:, front]
    left = pattern[rest][:, rest] + across @ across.T
    left.data[:] = 1.0
    # The order depends on the pattern alone; the diagonal keeps SuperLU from stopping at a singular matrix.
    left = (left + sp.diags_array(np.full(len(rest), 2.0 * num))).tocsc()
    return np.concatenate([front, rest[np.argsort(splu(left, permc_spec="MMD_AT_PLUS_A", **_SYMMETRIC).perm_c)]])


def _matrix(
    low: np.ndarray, high: np.ndarray, starts: np.ndarray, sizes: np.ndarray, offsets: np.ndarray, order: np.ndarray
) -> sp.csc_array:
    """The full matrix in the order of elimination, its values the places of its entries."""
    rows, columns, places = [], [], []
    for height, width in {*zip(sizes[low].tolist(), sizes[high].tolist(), strict=True)}:
        mine = np.flatnonzero((sizes[low] == height) & (sizes[high] == width))
        r, c = (axis.ravel() for axis in np.indices((height, width)))
        row, column = offsets[low[mine], None] + r, offsets[high[mine], None] + c
        place = starts[mine, None] + r * width + c
        apart = low[mine] != high[mine]
        rows += [row, column[apart]]
        columns += [column, row[apart]]
        places += [place, place[apart]]
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    rows, columns, places = (np.concatenate([part.ravel() for part in parts]) for parts in (rows, columns, places))
    matrix = sp.coo_array((places, (rank[rows], rank[columns])), shape=(len(order), len(order))).tocsc()
    matrix.sort_indices()
    return matrix


_SYMMETRIC = {"diag_pivot_thresh": 0.0, "panel_size": 6, "options": {"SymmetricMode": True}}
"""Panels of one pose: wider ones cost a third more time on graphs of poses."""


def _factorised(matrix: sp.csc_array, num_first: int, block: int) -> Callable[[np.ndarray], np.ndarray]:
    """x = matrix^-1 b; the first coordinates, block diagonal, are eliminated before the rest is factorised."""
    if not num_first:
        return splu(matrix, permc_spec="NATURAL", **_SYMMETRIC).solve
    front, rest = slice(None, num_first), slice(num_first, None)
    inverse = np.linalg.inv(matrix[front, front].data.reshape(-1, block, block))
    num = len(inverse)
    inverse = sp.bsr_array((inverse, np.arange(num), np.arange(num + 1)), shape=(num_first, num_first))
    across = matrix[rest, front]
    gain = (across @ inverse).tocsc()
    left = splu((matrix[rest, rest] - gain @ across.T).tocsc(), permc_spec="NATURAL", **_SYMMETRIC)

    def solved(b: np.ndarray) -> np.ndarray:
        x_rest = left.solve(b[rest] - gain @ b[front])
        return np.concatenate([inverse @ (b[front] - across.T @ x_rest), x_rest])

    return solved
