"""Normal equations of a chain with shared unknowns: a block arrow (room: solvers; pure JAX).

In: blocks of the chain, of neighbours, across, of what is shared; or a FactorGraph. Out: steps, and what the chain
leaves of the shared part. Cost grows with the length of the chain, not with its cube: each link is eliminated into the
next, all into what is shared.
"""

from itertools import combinations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.errors import SemlocError
from semloc_jax.solvers.dense import dense_hessian
from semloc_jax.solvers.graph import Block, FactorGraph, Family, Steps, Values, split, units_of
from semloc_jax.solvers.problem import Step


class ArrowEquations(eqx.Module):
    """Quadratic model cost + g x + 0.5 x H x of links 0 .. n-1 (d unknowns each) and s shared unknowns."""

    cost: Float[Array, ""]
    link: Float[Array, "n d d"]
    """Diagonal blocks of the chain."""
    next: Float[Array, "n d d"]
    """Block of link i (rows) and link i + 1 (columns); the last one is zero."""
    across: Float[Array, "n d s"]
    """Block of link i (rows) and the shared unknowns (columns)."""
    shared: Float[Array, "s s"]
    link_gradient: Float[Array, "n d"]
    shared_gradient: Float[Array, " s"]

    def damped(self, link: Float[Array, "*n d"], shared: Float[Array, " s"]) -> "ArrowEquations":
        """The equations with further information on every link and on the shared unknowns."""
        more = jnp.eye(self.link.shape[-1], dtype=self.link.dtype) * link[..., None]
        return eqx.tree_at(lambda e: (e.link, e.shared), self, (self.link + more, self.shared + jnp.diag(shared)))

    def step(
        self, damping: Float[Array, ""], link_units: Float[Array, "*n d"], shared_units: Float[Array, " s"]
    ) -> Step:
        """Minimum of the damped model; its tangent is the pair (links [n d], shared [s])."""
        of_link, of_shared = damping / link_units**2, damping / shared_units**2
        links, shared = minimum(self.damped(of_link, of_shared))
        # (H + damping) x = -g gives x H x = -g x - damping x x.
        promised = jnp.sum(self.link_gradient * links) + jnp.sum(self.shared_gradient * shared)
        held = jnp.sum(of_link * links * links) + jnp.sum(of_shared * shared * shared)
        lengths = [jnp.max(jnp.abs(x)) for x in (links / link_units, shared / shared_units) if x.size]
        return Step((links, shared), 0.5 * (promised - held), jnp.max(jnp.stack(lengths)))

    def dense(self) -> tuple[Float[Array, "d d"], Float[Array, " d"]]:
        """Hessian and gradient in full, the chain first: for tests and small problems."""
        num, size = self.link.shape[:2]
        shared = self.shared.shape[0]
        H = jnp.zeros((size * num + shared, size * num + shared), self.shared.dtype)
        H = H.at[size * num :, size * num :].set(self.shared)
        for i in range(num):
            here = slice(size * i, size * i + size)
            H = H.at[here, here].set(self.link[i]).at[here, size * num :].set(self.across[i])
            H = H.at[size * num :, here].set(self.across[i].T)
            if i + 1 < num:
                after = slice(size * i + size, size * i + 2 * size)
                H = H.at[here, after].set(self.next[i]).at[after, here].set(self.next[i].T)
        return H, jnp.concatenate([self.link_gradient.reshape(-1), self.shared_gradient])

    def covariance(self, link: int | None = None) -> Float[Array, "k k"]:
        """Joint covariance of one link (its unknowns first) and the shared unknowns; None: of the shared alone."""
        of_shared = jnp.linalg.inv(reduced(self)[0])
        if link is None:
            return of_shared
        size = self.link.shape[1]
        own = (
            jnp.zeros((*self.link.shape[:2], size), self.link.dtype).at[link].set(jnp.eye(size, dtype=self.link.dtype))
        )
        solved = _solve_chain(self.link, self.next, jnp.concatenate([self.across, own], axis=-1))[link]
        gain, alone = solved[:, :-size], solved[:, -size:]
        between = -_mul(gain, of_shared)
        of_link = alone + _mul(_mul(gain, of_shared), gain.T)
        return jnp.concatenate(
            [jnp.concatenate([of_link, between], axis=1), jnp.concatenate([between.T, of_shared], axis=1)]
        )


def reduced(
    equations: ArrowEquations,
) -> tuple[Float[Array, "s s"], Float[Array, " s"], Float[Array, "n d t"]]:
    """Information and gradient of the shared unknowns when every link is free, and the solved chain [across, gradient].

    Block elimination of the tridiagonal chain, then the Schur complement.
    """
    right = jnp.concatenate([equations.across, equations.link_gradient[..., None]], axis=-1)
    solved = _solve_chain(equations.link, equations.next, right)
    S = equations.shared - _sum(equations.across, solved[..., :-1])
    g = equations.shared_gradient - _sum(equations.across, solved[..., -1:])[:, 0]
    return 0.5 * (S + S.T), g, solved


def minimum(equations: ArrowEquations) -> tuple[Float[Array, "n d"], Float[Array, " s"]]:
    """The minimum of the quadratic model: steps of the chain and of the shared unknowns."""
    S, g, solved = reduced(equations)
    shared = -jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(S), g)
    return -(solved[..., -1] + _mul(solved[..., :-1], shared)), shared


def _solve_chain(D: Float[Array, "n d d"], B: Float[Array, "n d d"], R: Float[Array, "n d t"]) -> Float[Array, "n d t"]:
    """X with D_i X_i + B_i X_i+1 + B_i-1' X_i-1 = R_i."""
    size = D.shape[-1]

    def forward(carry: tuple, row: tuple) -> tuple[tuple, tuple]:
        gain, right = carry  # B_i-1' D_i-1^-1 B_i-1 and B_i-1' D_i-1^-1 R_i-1
        D_i, B_i, R_i = row
        factor = jax.scipy.linalg.cho_factor(D_i - gain)
        solved = jax.scipy.linalg.cho_solve(factor, jnp.concatenate([B_i, R_i - right], axis=1))
        carried = _mul(B_i.T, solved)
        return (carried[:, :size], carried[:, size:]), (solved[:, :size], solved[:, size:])

    def backward(after: Array, row: tuple) -> tuple[Array, Array]:
        along, free = row
        here = free - _mul(along, after)
        return here, here

    start = (jnp.zeros((size, size), D.dtype), jnp.zeros((size, R.shape[-1]), D.dtype))
    _, rows = jax.lax.scan(forward, start, (D, B, R))
    return jax.lax.scan(backward, start[1], rows, reverse=True)[1]


class ArrowProblem(eqx.Module):
    """A factor graph with normal equations of arrow shape; see `LeastSquaresProblem`.

    Variables of equal place in the families of the chain are one link, such as the pose, velocity and bias of one time.
    No factor binds two links but a link (first) and the next one (second).
    """

    graph: FactorGraph
    chain: tuple[str, ...] = eqx.field(static=True)

    def of(self, graph: FactorGraph) -> "ArrowProblem":
        """The same for other data on the same variables."""
        return ArrowProblem(graph, self.chain)

    def linearise(self, value: Values, skip: Bool[Array, ""]) -> ArrowEquations:
        """Normal equations at the values."""
        local, links, shared = self.graph.local(value), self._links(), self._shared()
        num, dtype = links[0].num, local[0].hessian.dtype
        here = {family.name: span for family, span in zip(links, _spans([f.kind.size for f in links]), strict=True)}
        there = {f.name: span for f, span in zip(shared, _spans([f.num * f.kind.size for f in shared]), strict=True)}
        size, width = sum(f.kind.size for f in links), sum(f.num * f.kind.size for f in shared)
        link, after = jnp.zeros((num, size, size), dtype), jnp.zeros((num, size, size), dtype)
        across = jnp.zeros((num, size, width), dtype)
        for block in self.graph.blocks(local):
            if block.rows not in here:
                continue
            if block.columns in here:
                link, after = _with_pair(link, after, block, here[block.rows], here[block.columns])
            else:
                across = across.at[:, here[block.rows], there[block.columns]].add(self._columns(block))
        g = self.graph.gradients(local)
        held = jnp.concatenate([jnp.asarray(self.graph.held(family.name)) for family in links], axis=1)
        return ArrowEquations(
            cost=sum(jnp.sum(part.cost) for part in local),
            link=link + jnp.eye(size, dtype=dtype) * held[:, None, :].astype(dtype),
            next=after,
            across=across,
            shared=dense_hessian(self.graph, local, shared) if shared else jnp.zeros((0, 0), dtype),
            link_gradient=jnp.concatenate([g[family.name] for family in links], axis=1),
            shared_gradient=jnp.concatenate([jnp.zeros(0, dtype), *(g[family.name].ravel() for family in shared)]),
        )

    def step(self, equations: ArrowEquations, damping: Float[Array, ""]) -> Step:
        """The damped step of every variable."""
        dtype, links, shared = equations.cost.dtype, self._links(), self._shared()
        link_units = jnp.asarray(np.concatenate([family.kind.units for family in links]), dtype)
        step = equations.step(damping, link_units, jnp.asarray(units_of(shared), dtype))
        along, rest = step.tangent
        parts = jnp.split(along, np.cumsum([family.kind.size for family in links])[:-1], axis=1)
        steps = {family.name: part for family, part in zip(links, parts, strict=True)}
        return step._replace(tangent=steps | split(rest, shared))

    def retract(self, value: Values, tangent: Steps) -> Values:
        """The values after a step."""
        return self.graph.retract(value, tangent)

    def _links(self) -> list[Family]:
        return [self.graph.family(name) for name in self.chain]

    def _shared(self) -> list[Family]:
        return [family for family in self.graph.families if family.name not in self.chain]

    def _columns(self, block: Block) -> Float[Array, "n a c"]:
        """Blocks of links and shared variables, summed, in the columns of the shared family."""
        rows, columns = self.graph.family(block.rows), self.graph.family(block.columns)
        total = jnp.zeros((rows.num, columns.num, rows.kind.size, columns.kind.size), block.hessian.dtype)
        total = total.at[block.row_key, block.column_key].add(block.hessian)
        return total.swapaxes(1, 2).reshape(rows.num, rows.kind.size, -1)


def arrow_problem(graph: FactorGraph, chain: tuple[str, ...]) -> ArrowProblem:
    """The graph as a chain of the named families with all other variables shared.

    Raises:
        SemlocError: The families differ in length, or a factor binds links that are no neighbours.
    """
    nums = {name: graph.family(name).num for name in chain}
    if len(set(nums.values())) > 1:
        raise SemlocError(f"arrow: families of the chain have {nums} variables; expected as many of each")
    for factors in graph.factors:
        keys = [key for name, key in zip(factors.on, factors.keys, strict=True) if name in chain]
        for first, second in combinations(keys, 2):
            if isinstance(first, jax.core.Tracer) or isinstance(second, jax.core.Tracer):
                continue
            far = np.abs(np.asarray(second) - np.asarray(first)) > 1
            if far.any():
                pair = int(np.asarray(first)[far][0]), int(np.asarray(second)[far][0])
                raise SemlocError(
                    f"arrow: a factor on {factors.on} binds links {pair[0]} and {pair[1]}; expected neighbours only; "
                    "solve a graph with loops as a sparse one"
                )
    return ArrowProblem(graph, chain)


def _with_pair(
    link: Array, after: Array, block: Block, above: slice, beside: slice
) -> tuple[Float[Array, "n d d"], Float[Array, "n d d"]]:
    """Blocks of the chain with those of factors that bind one link or two neighbours; the lower half is left out."""
    apart = (jnp.asarray(block.column_key) - jnp.asarray(block.row_key))[:, None, None]
    own, later = jnp.where(apart == 0, block.hessian, 0.0), jnp.where(apart == 1, block.hessian, 0.0)
    here = (block.row_key, above, beside)
    return link.at[here].add(own), after.at[here].add(later)


def _spans(sizes: list[int]) -> list[slice]:
    return [slice(end - size, end) for size, end in zip(sizes, np.cumsum(sizes, dtype=int).tolist(), strict=True)]


def _sum(across: Float[Array, "n d s"], solved: Float[Array, "n d t"]) -> Float[Array, "s t"]:
    return jnp.einsum("nks,nkt->st", across, solved, precision=jax.lax.Precision.HIGHEST)


def _mul(A: Array, b: Array) -> Array:
    return jnp.matmul(A, b, precision=jax.lax.Precision.HIGHEST)
