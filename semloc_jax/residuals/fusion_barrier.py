"""A wall that keeps XLA from computing the same thing once for every consumer (room: residuals; pure JAX).

In: arrays. Out: the same arrays, stored in memory.
XLA on CPU fuses a texture lookup into each of the seven rows that use it (7 lookups instead of 1: 3 times slower) and
drops `lax.optimization_barrier`. A conditional on a predicate that is known only at run time is never fused across.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool


def stored(always: Bool[Array, ""], *arrays: Array) -> tuple[Array, ...]:
    """The arrays, computed once and materialised before anything that uses them.

    Args:
        always: True at run time; it must be an argument of the compiled function (a constant would be folded away) and
            must not be batched.
        arrays: What is to be computed once. Two real arrays that share most of their work are best given as one complex
            array: they then come out of one loop.
    """

    def on_cpu(always: Array, *arrays: Array) -> tuple[Array, ...]:
        return jax.lax.cond(always, lambda *kept: kept, lambda *kept: tuple(map(jnp.zeros_like, kept)), *arrays)

    def elsewhere(_: Array, *arrays: Array) -> tuple[Array, ...]:
        return jax.lax.optimization_barrier(arrays)

    return jax.lax.platform_dependent(always, *arrays, cpu=on_cpu, default=elsewhere)
