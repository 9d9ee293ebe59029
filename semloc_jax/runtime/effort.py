"""How much effort the compiler takes (room: runtime; host).

In: how many frames a run has. Out: options of XLA for the programs that it makes.
The same run gets the same effort, whatever is on disk already: programs of both kinds round differently.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

FEW_FRAMES = 16
"""Runs of so many frames are done before the full effort pays: it compiles the programs of `localize` in 8 instead of 3
CPU seconds, and saves some 30 ms a frame. Few enough that a warm run loses less than half a second by it."""
QUICK: dict[str, Any] = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_parallel_codegen_split_count": 1,
}
"""Compiles in two fifths of the CPU time; what it compiles runs 1.2 (solves, whose inner loops are native kernels) to 4
times as long (chains of array operations). Measured, jaxlib 0.10.1."""
_PARTS = {"xla_cpu_parallel_codegen_split_count": 4}
"""LLVM compiles a program in so many parts, which may run side by side. By default 32, of which each costs: together a
tenth of the CPU time."""
UNFUSED: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False} | _PARTS
"""Compiles in two thirds of the CPU time. A solve, whose inner loops are native kernels, runs as fast as before; a
program that is one long chain of array operations (`fused`) runs a third slower. Measured, jaxlib 0.10.1."""
FUSED: dict[str, Any] = _PARTS

_runs_of_few: list[int] = []


@contextmanager
def effort_for(num_frames: int) -> Iterator[None]:
    """Within the block, in all threads, programs are compiled for a run of so many frames."""
    if num_frames > FEW_FRAMES:
        yield
        return
    _runs_of_few.append(num_frames)
    try:
        yield
    finally:
        _runs_of_few.remove(num_frames)


def is_quick() -> bool:
    """Whether the present run has few frames."""
    return bool(_runs_of_few)


def options(fused: bool) -> dict[str, Any]:
    """Options of XLA for a program of the present run."""
    if is_quick():
        return QUICK
    return FUSED if fused else UNFUSED
