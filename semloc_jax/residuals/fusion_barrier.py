"""A wall that keeps XLA from computing the same thing once for every consumer (room: residuals; pure JAX).

In: a function and its operands. Out: its result, with the operands stored in memory first.
XLA on CPU fuses a texture lookup into each of the seven rows that use it (7 lookups instead of 1: 3 times slower) and
drops `lax.optimization_barrier`. A conditional on a predicate that is known only at run time is never fused across.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool


def behind_barrier(always: Bool[Array, ""], function: Callable[..., Any], *operands: Array) -> Any:
    """function(*operands), with operands materialised on CPU; a plain call elsewhere.

    Args:
        always: True at run time; it must be an argument of the compiled function (a constant would be folded away) and
            must not be batched.
        function: Takes the operands; returns a tree of arrays.
        operands: What is to be computed once and stored.
    """
    like = jax.eval_shape(function, *operands)

    def never(*_: Array) -> Any:
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like)

    def on_cpu(*flat: Array) -> Any:
        return jax.lax.cond(flat[0], function, never, *flat[1:])

    def elsewhere(*flat: Array) -> Any:
        return function(*jax.lax.optimization_barrier(flat[1:]))

    return jax.lax.platform_dependent(always, *operands, cpu=on_cpu, default=elsewhere)
