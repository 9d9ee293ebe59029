"""Dense normal equations: for tens of variables (room: solvers; pure JAX).

In: a FactorGraph and its values. Out: DenseEquations: step, marginal, covariance.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.solvers.factors import Local
from semloc_jax.solvers.graph import FactorGraph, Family, Steps, Values, split, units_of
from semloc_jax.solvers.problem import Step


class DenseEquations(eqx.Module):
    """Quadratic model cost + gradient x + 0.5 x information x."""

    cost: Float[Array, ""]
    gradient: Float[Array, " d"]
    information: Float[Array, "d d"]

    def step(self, damping: Float[Array, ""], units: Float[Array, " d"]) -> Step:
        """Minimum of the damped model; its tangent is one vector."""
        # In the units of the damping the matrix is well scaled, which float32 needs.
        scaled = units[:, None] * self.information * units
        g = units * self.gradient
        damped = scaled + damping * jnp.eye(len(units), dtype=units.dtype)
        x = -jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(damped), g)
        # (H + damping) x = -g gives x H x = -g x - damping x x.
        change = 0.5 * (jnp.dot(g, x) - damping * jnp.dot(x, x))
        return Step(units * x, change, jnp.max(jnp.abs(x)))

    def covariance(self, of: Int[np.ndarray, " k"] | None = None) -> Float[Array, "k k"]:
        """Joint covariance of the named coordinates, the others unknown; None for all."""
        wanted = jnp.eye(len(self.gradient), dtype=self.gradient.dtype)
        wanted = wanted if of is None else wanted[:, of]
        lower = jnp.linalg.cholesky(self.information)
        half = jax.scipy.linalg.solve_triangular(lower, wanted, lower=True)
        return _mul(half.T, half)


def marginal(equations: DenseEquations, gone: Int[np.ndarray, " g"], kept: Int[np.ndarray, " k"]) -> DenseEquations:
    """What the equations say of the `kept` unknowns when the `gone` ones are free: the Schur complement."""
    H, g = equations.information, equations.gradient
    across = jnp.linalg.solve(H[np.ix_(gone, gone)], jnp.concatenate([H[np.ix_(gone, kept)], g[gone, None]], axis=1))
    back = _mul(H[np.ix_(kept, gone)], across)
    # The cost at the best value of what is gone.
    cost = equations.cost - 0.5 * _mul(g[gone], across[:, -1])
    return DenseEquations(cost, g[kept] - back[:, -1], H[np.ix_(kept, kept)] - back[:, :-1])


def dense_hessian(graph: FactorGraph, local: list[Local], families: Sequence[Family]) -> Float[Array, "d d"]:
    """Hessian of the named families in full, family by family; 1 on the diagonal of what is locked."""
    sizes = [family.num * family.kind.size for family in families]
    starts = dict(zip((family.name for family in families), np.cumsum([0, *sizes]).tolist(), strict=False))
    held = jnp.concatenate([jnp.asarray(graph.held(family.name)).ravel() for family in families])
    H = jnp.diag(held.astype(local[0].hessian.dtype))
    for factors, found in zip(graph.factors, local, strict=True):
        at, own = [], []
        for name, key, span in zip(factors.on, factors.keys, graph.spans(factors), strict=True):
            if name in starts:
                size = span.stop - span.start
                at.append(starts[name] + jnp.asarray(key)[:, None] * size + np.arange(size))
                own.append(np.arange(span.start, span.stop))
        if at:  # one scatter for each family of factors: one for each block takes longer to compile and to run
            rows, own = jnp.concatenate(at, axis=1), np.concatenate(own)
            H = H.at[rows[:, :, None], rows[:, None, :]].add(found.hessian[:, own][:, :, own])
    return H


class DenseProblem(eqx.Module):
    """A factor graph with dense normal equations; see `LeastSquaresProblem`."""

    graph: FactorGraph

    def of(self, graph: FactorGraph) -> "DenseProblem":
        """The same for other data on the same variables."""
        return DenseProblem(graph)

    def linearise(self, value: Values, skip: Bool[Array, ""]) -> DenseEquations:
        """Normal equations at the values."""
        local = self.graph.local(value)
        g = self.graph.gradients(local)
        gradient = jnp.concatenate([g[family.name].ravel() for family in self.graph.families])
        H = dense_hessian(self.graph, local, self.graph.families)
        return DenseEquations(sum(jnp.sum(part.cost) for part in local), gradient, H)

    def step(self, equations: DenseEquations, damping: Float[Array, ""]) -> Step:
        """The damped step of every variable."""
        units = jnp.asarray(units_of(self.graph.families), equations.gradient.dtype)
        step = equations.step(damping, units)
        return step._replace(tangent=split(step.tangent, self.graph.families))

    def retract(self, value: Values, tangent: Steps) -> Values:
        """The values after a step."""
        return self.graph.retract(value, tangent)


def _mul(A: Array, b: Array) -> Array:
    return jnp.matmul(A, b, precision=jax.lax.Precision.HIGHEST)
