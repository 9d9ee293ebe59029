"""Programs of formulas under test: they run once or twice, so compiling them is all that they cost."""

from functools import partial

import jax

_LITTLE_EFFORT = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_parallel_codegen_split_count": 1,
}
"""Compiles formulas four times as fast as the effort that users get. These are options of XLA, not of JAX."""

jit_quickly = partial(jax.jit, compiler_options=_LITTLE_EFFORT)
"""`jax.jit` for what a test would otherwise do operation by operation. Not for programs that the package compiles for
its users, nor where the test is about what the compiler makes of them. JAX takes it for the outermost function only."""
