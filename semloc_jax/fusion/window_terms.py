"""Cost terms of the user in the sliding window: rows of fixed size for each state (room: fusion; host).

In: terms that say which kinds there are, one measured term. Out: rows with and without it, their Factors.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.errors import SemlocError
from semloc_jax.fusion.measurements import Innovation
from semloc_jax.residuals.pose_terms import Terms, terms_linearised
from semloc_jax.solvers.factors import Factors

_linearised = jax.jit(terms_linearised)
"""One program for each kind of term and number of observations."""


class TermRows(NamedTuple):
    """All observations of one kind of term: leading axes are states and observations of a state."""

    data: tuple[np.ndarray, ...]
    sqrt_info: np.ndarray
    """0 for a row that is not filled."""


def empty_rows(kinds: Terms, num_states: int) -> tuple[TermRows, ...]:
    """Rows of a window in which nothing was measured; each state takes as many observations as its kind has."""

    def repeated(leaf: np.ndarray) -> np.ndarray:
        return np.tile(np.asarray(leaf), (num_states, *[1] * np.ndim(leaf)))

    return tuple(TermRows(tuple(map(repeated, k.data)), 0.0 * repeated(k.sqrt_info)) for k in kinds)


def factors_of(kinds: Terms, rows: Sequence[TermRows], is_used: Bool[Array | np.ndarray, " n"]) -> tuple[Factors, ...]:
    """The factors of all rows; those of states that are not used have no information."""
    found = []
    for kind, (data, sqrt_info) in zip(kinds, rows, strict=True):
        states, per_state = sqrt_info.shape[:2]
        shown = jnp.where(is_used.reshape(-1, *[1] * (sqrt_info.ndim - 1)), sqrt_info, 0.0)
        flat = [leaf.reshape(-1, *leaf.shape[2:]) for leaf in (*data, shown)]
        keys = (np.repeat(np.arange(states), per_state),)
        found.append(
            Factors(kind.residual, kind.on, keys, tuple(flat[:-1]), flat[-1], None, kind.robust, kind.linearised)
        )
    return tuple(found)


def with_term(kinds: Terms, rows: tuple[TermRows, ...], state: int, term: Factors) -> tuple[TermRows, ...]:
    """The rows with one more term of a state.

    Raises:
        SemlocError: the rows of that state are full.
    """
    place = require_kind(kinds, term)
    data, sqrt_info = rows[place]
    free = np.flatnonzero(~sqrt_info[state].reshape(sqrt_info.shape[1], -1).any(axis=1))
    num = len(term.keys[0])
    if num > len(free):
        raise SemlocError(
            f"window: {num} more observations of {_name(term)} at one time, {len(free)} of {sqrt_info.shape[1]} rows "
            "are free; give SlidingWindow(terms=...) a term with as many observations as can come at one time"
        )

    def filled(known: np.ndarray, new: np.ndarray) -> np.ndarray:
        changed = known.copy()
        changed[state, free[:num]] = new
        return changed

    own = TermRows(tuple(map(filled, data, term.data)), filled(sqrt_info, term.sqrt_info))
    return (*rows[:place], own, *rows[place + 1 :])


def cleared(rows: tuple[TermRows, ...], state: int) -> tuple[TermRows, ...]:
    """The rows with those of one state empty."""

    def emptied(sqrt_info: np.ndarray) -> np.ndarray:
        changed = sqrt_info.copy()
        changed[state] = 0.0
        return changed

    return tuple(own._replace(sqrt_info=emptied(own.sqrt_info)) for own in rows)


def without_first(rows: tuple[TermRows, ...]) -> tuple[TermRows, ...]:
    """The rows one state later."""
    return jax.tree.map(lambda leaf: np.roll(leaf, -1, axis=0), rows)


def of_first_of_two(rows: tuple[TermRows, ...]) -> tuple[TermRows, ...]:
    """The rows of the first two states, the second one without information."""
    return cleared(jax.tree.map(lambda leaf: leaf[:2], rows), 1)


def is_finite(term: Factors) -> bool:
    """Whether every number of a term is one."""
    return all(np.isfinite(leaf).all() for leaf in (*term.data, term.sqrt_info))


def fit(
    term: Factors, T_map_base: Float[np.ndarray, "4 4"], covariance: Float[np.ndarray, "6 6"]
) -> tuple[Innovation, Float[np.ndarray, " k"], Float[np.ndarray, "k 6"]]:
    """How a term fits a predicted pose (not yet judged), its whitened residuals and their derivatives."""
    with jax.enable_x64(True):
        r, J = (np.asarray(leaf) for leaf in _linearised((term,), np.asarray(T_map_base, np.float64)))
    square = float(r @ np.linalg.solve(np.eye(len(r)) + J @ covariance @ J.T, r))
    return Innovation(square, len(r), False), r, J


def require_kind(kinds: Terms, term: Factors) -> int:
    """Which of the kinds of a window a term is.

    Raises:
        SemlocError: none of them.
    """

    def shapes(one: Factors) -> list:
        return [np.shape(leaf)[1:] for leaf in (*one.data, one.sqrt_info)]

    for place, kind in enumerate(kinds):
        if kind.residual == term.residual and shapes(kind) == shapes(term):
            return place
    known = ", ".join(map(_name, kinds)) or "none"
    raise SemlocError(
        f"window: a term {_name(term)} with data {shapes(term)}; its kinds are: {known}. Name the kinds that will come "
        "when it is made: SlidingWindow(terms=(pose_term(...),))"
    )


def _name(term: Factors) -> str:
    return getattr(term.residual, "__name__", repr(term.residual))
