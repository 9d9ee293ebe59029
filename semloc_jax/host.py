"""What pure JAX code asks of the host without knowing it: native kernels, a store of compiled programs (room: ground;
standard library only).

In: loaders, offered by the front page of the package. Out: what they load, on first use.
Where nothing is offered, or the host has none, everything is computed by JAX alone, with the same numbers.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol


@dataclass(frozen=True)
class NativeStatus:
    """Whether native kernels are registered with JAX, and why not."""

    available: bool
    text: str


class ProgramStore(Protocol):
    """Compiled programs that outlive a process."""

    def is_open(self) -> bool:
        """Whether programs are kept at present."""

    def is_quick(self) -> bool:
        """Whether programs are compiled for a run of few frames at present."""

    def obtain(self, program: Any, static: dict[str, Any], tree: Any, leaves: list) -> tuple[Callable, Any, tuple]:
        """The compiled program for some arguments, the structure of its result, and the leaves of the result."""


_LOADERS: dict[str, Callable[[], Any]] = {}


def offer(native: Callable[[], Callable[[str], NativeStatus]], programs: Callable[[], ProgramStore]) -> None:
    """Say how kernels are built and registered, and where programs are kept; both are asked on first use only."""
    _LOADERS.update(native=native, programs=programs)
    _loaded.cache_clear()


@functools.cache
def _loaded(service: str) -> Any:
    load = _LOADERS.get(service)
    return None if load is None else load()


def native_status(part: str = "common") -> NativeStatus:
    """Whether a part of the native kernels can be called; the first call builds and registers it if need be.

    Args:
        part: See `native.build.status`.
    """
    status = _loaded("native")
    if status is None:
        return NativeStatus(False, "not offered: semloc_jax was not imported through its front page")
    return status(part)


def program_store() -> ProgramStore | None:
    """Where compiled programs are kept; None where nowhere."""
    return _loaded("programs")
