"""Normal equations of factors that bind a state, or a state and the next one (room: fusion; pure JAX).

In: a FactorGraph of the families of `inertial_states`. Out: DenseEquations over all states of a window.
Rows of all factors of two neighbours are put side by side and squared at once, and blocks are gathered into the matrix
of the window: adding every product to its place one by one took half of the time of an evaluation.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.fusion.inertial_states import AT, KINDS, STATE, unknowns_of
from semloc_jax.solvers.dense import DenseEquations
from semloc_jax.solvers.factors import Factors, WeighedRows
from semloc_jax.solvers.graph import FactorGraph, Values

_HIGHEST = jax.lax.Precision.HIGHEST
_PAIR = 2 * STATE
"""Unknowns of a state and the next."""


def chain_equations(graph: FactorGraph, value: Values, at: Values, num: int) -> DenseEquations:
    """Cost, gradient and information by the unknowns of a window of `num` states.

    Args:
        graph: Factor k of a family binds state k, or states k and k + 1 in that order; their keys are known when this
            is traced. There may be fewer factors than states: the others are left alone.
        value: Where residuals are taken.
        at: Where derivatives are taken.
    """
    rows = [factors.rows(value, KINDS, at) for factors in graph.factors]
    r = jnp.concatenate([_padded(part.residuals, num) for part in rows], axis=1)
    J = jnp.concatenate([_padded(_placed(*one), num) for one in zip(graph.factors, rows, strict=True)], axis=1)
    g = jnp.einsum("nri,nr->ni", J, r, precision=_HIGHEST)
    H = jnp.einsum("nri,nrj->nij", J, J, precision=_HIGHEST)
    here, after = slice(None, STATE), slice(STATE, None)
    own = H[:, here, here] + _later(H[:, after, after])
    flat = jnp.concatenate([own.ravel(), H[:, here, after].ravel(), jnp.zeros(1, H.dtype)])
    gradient = (g[:, here] + _later(g[:, after])).ravel()[_states_first(num)]
    return DenseEquations(sum(jnp.sum(part.cost) for part in rows), gradient, flat[_places(num)])


def _placed(factors: Factors, rows: WeighedRows) -> Float[Array, "n r p"]:
    """Derivatives by all unknowns of two neighbours."""
    source, column = np.full(_PAIR, rows.by_tangent.shape[-1]), 0
    for name, key in zip(factors.on, factors.keys, strict=True):
        apart = set((np.asarray(key) - np.arange(len(key))).tolist())
        assert apart <= {0} or apart <= {1}, f"{name} {apart}: expected a state and the next"
        start = AT[name].start + STATE * max(apart)
        size = KINDS[name].size
        source[start : start + size] = column + np.arange(size)
        column += size
    return jnp.pad(rows.by_tangent, ((0, 0), (0, 0), (0, 1)))[..., source]


def _padded(parts: Float[Array, "m ..."], num: int) -> Float[Array, "n ..."]:
    return jnp.pad(parts, ((0, num - len(parts)), *((0, 0),) * (parts.ndim - 1)))


def _later(parts: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
    """Those of the state before."""
    return jnp.concatenate([jnp.zeros_like(parts[:1]), parts[:-1]])


@cache
def _states_first(num: int) -> Int[np.ndarray, " d"]:
    """Where each unknown of a window stands when they are ordered by states."""
    place = np.empty(STATE * num, int)
    for state in range(num):
        place[unknowns_of(np.array([state]), num)] = STATE * state + np.arange(STATE)
    return place


@cache
def _places(num: int) -> Int[np.ndarray, "d d"]:
    """Where each entry of the matrix stands in (own blocks, blocks with the next, one zero)."""
    state, own = np.divmod(_states_first(num), STATE)
    apart, block = state[None, :] - state[:, None], STATE * STATE
    a, b, first = own[:, None], own[None, :], np.minimum(state[:, None], state[None, :]) * block
    off = num * block + first + np.where(apart > 0, STATE * a + b, STATE * b + a)
    return np.select([apart == 0, np.abs(apart) == 1], [first + STATE * a + b, off], 2 * num * block)
