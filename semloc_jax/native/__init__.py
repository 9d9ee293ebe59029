"""Hand-written kernels of the innermost loop for CPUs, built on first use where there is a C++ compiler (room: native).

In: C++ sources beside this file. Out: `is_available` and the custom calls of `native.calls`.
Nothing depends on them: without a compiler, on another platform, in float64 or for another loss the same numbers come
from pure JAX, several times slower.
"""

from semloc_jax.native.build import NativeStatus, is_available, status

__all__ = ["NativeStatus", "is_available", "status"]
