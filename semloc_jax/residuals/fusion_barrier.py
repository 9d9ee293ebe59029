"""A wall that keeps XLA from computing the same thing once for every consumer (room: residuals; pure JAX).

In: a texture and arrays. Out: the same arrays, stored in memory.
XLA on CPU fuses a texture lookup into each of the seven rows that use it (7 lookups instead of 1: 3 times slower) and
drops `lax.optimization_barrier`. A conditional on a predicate that is known only at run time is never fused across.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from semloc_jax.residuals.texture import RampTexture

_NO_TEXEL = np.uint32(0xFFFFFFFF)
"""Bytes of texels end at 254, so no texel is this; XLA does not know."""


class Walls(NamedTuple):
    """Two predicates that are true, which XLA finds out at run time only.

    XLA merges walls on one predicate that follow each other directly: take them in turn.
    """

    odd: Bool[Array, ""]
    even: Bool[Array, ""]

    @classmethod
    def of(cls, texture: RampTexture) -> "Walls":
        """Walls from the content of a texture: it is data of every evaluation, and no batch of poses has its own."""
        return cls(texture.texels[0] != _NO_TEXEL, texture.texels[-1] != _NO_TEXEL)


def stored(wall: Bool[Array, ""], *arrays: Array) -> tuple[Array, ...]:
    """The arrays, computed once and materialised before anything that uses them.

    Args:
        wall: One of `Walls`; it must not be batched, and the texture it comes from must be an argument of the compiled
            function (a constant would be folded away).
        arrays: What is to be computed once. Two real arrays that share most of their work are best given as one complex
            array: they then come out of one loop.
    """

    def on_cpu(wall: Array, *arrays: Array) -> tuple[Array, ...]:
        return jax.lax.cond(wall, lambda *kept: kept, lambda *kept: tuple(map(jnp.zeros_like, kept)), *arrays)

    def elsewhere(_: Array, *arrays: Array) -> tuple[Array, ...]:
        return jax.lax.optimization_barrier(arrays)

    return jax.lax.platform_dependent(wall, *arrays, cpu=on_cpu, default=elsewhere)
