"""What else is known of one pose than masks and a prior (room: residuals; pure JAX).

In: residuals of one pose, what was measured. Out: Factors that a single pose, the window and a whole drive all take:
their cost, and their equations by the right tangent of the pose.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from semloc_jax.solvers.factors import POSE, Factors, Local

Terms = tuple[Factors, ...]
TermSource = Callable[[Any], Terms]
"""What else was measured of the pose of a frame, in the map frame."""


@dataclass(frozen=True)
class _FromOrigin:
    """A residual of poses in the map frame, of poses relative to an origin."""

    function: Callable[..., Any]

    def __call__(self, T_local_base: Float[Array, "4 4"], origin_map: Float[Array, "3"], *rest: Any) -> Any:
        return self.function(T_local_base.at[:3, 3].add(origin_map.astype(T_local_base.dtype)), *rest)


def from_origin(terms: Terms, origin_map: Float[np.ndarray, "3"]) -> Terms:
    """The same terms for poses relative to an origin in the map frame [m]."""

    def moved(term: Factors) -> Factors:
        origins = np.tile(np.asarray(origin_map, np.float64), (len(term.keys[0]), 1))
        linearised = None if term.linearised is None else _FromOrigin(term.linearised)
        return Factors(
            _FromOrigin(term.residual),
            term.on,
            term.keys,
            (origins, *term.data),
            term.sqrt_info,
            term.weight,
            term.robust,
            linearised,
        )

    return tuple(moved(term) for term in terms)


def one_of_each(terms_of_pose: Iterable[Terms]) -> Terms:
    """One term of each kind that occurs, the one with most observations: what a `SlidingWindow` is made for."""
    found: dict[tuple, Factors] = {}
    for term in (term for terms in terms_of_pose for term in terms):
        known = found.get(_kind(term))
        if known is None or len(known.keys[0]) < len(term.keys[0]):
            found[_kind(term)] = term
    return tuple(found.values())


def _kind(term: Factors) -> tuple:
    """What terms of one kind have alike."""
    return term.residual, term.robust, tuple(np.shape(leaf)[1:] for leaf in (*term.data, term.sqrt_info))


def joined(terms_of_pose: Sequence[Terms]) -> Terms:
    """The terms of many poses as factors of one graph: those of a kind in one family, their keys the poses."""
    kinds: dict[tuple, list[tuple[int, Factors]]] = {}
    for pose, terms in enumerate(terms_of_pose):
        for term in terms:
            kinds.setdefault(_kind(term), []).append((pose, term))

    def family(members: list[tuple[int, Factors]]) -> Factors:
        keys = np.concatenate([np.full(len(term.keys[0]), pose) for pose, term in members])
        leaves = zip(*[(*term.data, term.sqrt_info) for _, term in members], strict=True)
        *data, sqrt_info = [np.concatenate([np.asarray(leaf) for leaf in own]) for own in leaves]
        first = members[0][1]
        return Factors(first.residual, ("pose",), (keys,), tuple(data), sqrt_info, None, first.robust, first.linearised)

    return tuple(family(members) for members in kinds.values())


def terms_cost(terms: Terms, T_local_base: Float[Array, "4 4"]) -> Float[Array, ""]:
    """Cost of all terms at a pose [nats]."""
    at = {"pose": T_local_base[None]}
    costs = [jnp.sum(_like(term, T_local_base).costs(at)) for term in terms]
    return sum(costs, jnp.zeros((), T_local_base.dtype))


def terms_residual(terms: Terms, T_local_base: Float[Array, "4 4"]) -> Float[Array, " n"]:
    """Residuals whose half squared norm is `terms_cost`."""
    at, parts = {"pose": T_local_base[None]}, [jnp.zeros(0, T_local_base.dtype)]
    for term in terms:
        own = _like(term, T_local_base)
        r = own.residuals(at)
        squares = jnp.sum(r * r, axis=1)
        known = squares > 0.0
        share = jnp.where(known, 2.0 * own.costs(at) / jnp.where(known, squares, 1.0), 1.0)
        parts.append((jnp.sqrt(share)[:, None] * r).ravel())
    return jnp.concatenate(parts)


def terms_equations(terms: Terms, T_local_base: Float[Array, "4 4"]) -> Local:
    """Cost [nats], gradient [6] and Gauss-Newton Hessian [6 6] of all terms by the right tangent of the pose."""
    dtype = T_local_base.dtype
    cost, gradient, hessian = jnp.zeros((), dtype), jnp.zeros(6, dtype), jnp.zeros((6, 6), dtype)
    for term in terms:
        local = _like(term, T_local_base).local({"pose": T_local_base[None]}, {"pose": POSE})
        cost, gradient = cost + jnp.sum(local.cost), gradient + jnp.sum(local.gradient, axis=0)
        hessian = hessian + jnp.sum(local.hessian, axis=0)
    return Local(cost, gradient, hessian)


def terms_linearised(
    terms: Terms, T_local_base: Float[ArrayLike, "4 4"]
) -> tuple[Float[Array, " n"], Float[Array, "n 6"]]:
    """Whitened residuals before any robust loss, and their derivatives by the right tangent of the pose."""
    T_local_base = jnp.asarray(T_local_base)
    found = [_like(term, T_local_base).derivatives({"pose": T_local_base[None]}, {"pose": POSE}) for term in terms]
    return jnp.concatenate([r.ravel() for r, _ in found]), jnp.concatenate([J.reshape(-1, 6) for _, J in found])


def _like(term: Factors, T_local_base: Float[Array, "4 4"]) -> Factors:
    """The term in the float type of the pose: measurements in float64 would make the whole solve so."""

    def cast(leaf: ArrayLike) -> Array:
        leaf = jnp.asarray(leaf)
        return leaf.astype(T_local_base.dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    data, sqrt_info, weight = jax.tree.map(cast, (term.data, term.sqrt_info, term.weight))
    return eqx.tree_at(
        lambda t: (t.data, t.sqrt_info, t.weight), term, (data, sqrt_info, weight), is_leaf=lambda leaf: leaf is None
    )
