"""Adam, one step at a time (room: learning; JAX or NumPy).

In: parameters and their gradient as trees of arrays. Out: the next parameters and what Adam remembers.
"""

import math
from typing import Any, NamedTuple

import jax

_FIRST, _SECOND, _SMALL = 0.9, 0.99, 1e-8
"""Decay of the means of gradient and squared gradient; a short memory for the square, as batches are few."""


class AdamState(NamedTuple):
    """Running means; trees like the parameters."""

    step: int | jax.Array
    first: Any
    second: Any

    @classmethod
    def begin(cls, parameters: Any) -> "AdamState":
        """Nothing seen yet."""
        zeros = jax.tree.map(lambda x: 0.0 * x, parameters)
        return cls(0, zeros, zeros)


def adam_step(parameters: Any, gradient: Any, state: AdamState, rate: Any) -> tuple[Any, AdamState]:
    """Parameters a step down the gradient (Kingma and Ba 2015), and the new means."""
    step = state.step + 1
    first = jax.tree.map(lambda m, g: _FIRST * m + (1 - _FIRST) * g, state.first, gradient)
    second = jax.tree.map(lambda v, g: _SECOND * v + (1 - _SECOND) * g**2, state.second, gradient)
    one, two = 1 - _FIRST**step, 1 - _SECOND**step
    moved = jax.tree.map(lambda x, m, v: x - rate * (m / one) / ((v / two) ** 0.5 + _SMALL), parameters, first, second)
    return moved, AdamState(step, first, second)


def falling_rate(rate: float, step: int, num_steps: int, level_share: float = 0.0) -> float:
    """The rate of a step 1 ... `num_steps`: level for a share of them, then half a cosine down to nothing."""
    share = max((step - 1) / num_steps - level_share, 0.0) / (1.0 - level_share)
    return rate * 0.5 * (1 + math.cos(math.pi * share))
