"""Functions whose compiled programs may outlive the process (room: runtime; pure JAX).

In: a function of arrays and static configuration. Out: the same function, jitted; where the host keeps programs
(`runtime.programs`), it is neither traced nor compiled a second time.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from semloc_jax.host import program_store


def stored_program(*static_argnames: str, fused: bool = False) -> Callable[[Callable], "StoredProgram"]:
    """Decorator: `jax.jit` whose programs outlive the process, where JAX has a compilation cache on disk.

    Args:
        static_argnames: Arguments that are no arrays.
        fused: Whether the program is worth the longer compilation that fuses chains of operations; see
            `runtime.programs`.
    """
    return lambda function: StoredProgram(function, static_argnames, fused)


class StoredProgram:
    """A jitted function with programs on disk. Inside another traced function it is an ordinary jitted function."""

    def __init__(self, function: Callable, static_argnames: tuple[str, ...], fused: bool = False) -> None:
        """Static arguments must be hashable and have a repr that tells them apart (frozen dataclasses do)."""
        functools.update_wrapper(self, function)
        self.static_argnames, self.fused = static_argnames, fused
        self.jitted = jax.jit(function, static_argnames=static_argnames)
        self._signature = inspect.signature(function)
        self._names = tuple(self._signature.parameters)
        self._programs: dict[tuple, tuple[Callable, Any]] = {}

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """The result of the function."""
        store = program_store()
        if store is None or not store.is_open():
            return self.jitted(*args, **kwargs)
        arguments = self._by_name(args, kwargs)
        static = {name: arguments.pop(name) for name in self.static_argnames}
        leaves, tree = jax.tree.flatten(arguments)
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return self.jitted(*args, **kwargs)
        leaves = [_array(leaf) for leaf in leaves]
        shapes = tuple([(leaf.shape, leaf.dtype) for leaf in leaves])
        key = (tuple(static.items()), tree, shapes, jax.config.jax_enable_x64, store.is_quick())
        if key in self._programs:
            program, structure = self._programs[key]
            found = program(*leaves)
        elif _ADDRESS in str(tree):
            return self.jitted(*args, **kwargs)
        else:
            program, skeleton, found = store.obtain(self, static, tree, leaves)
            structure = jax.tree.structure(skeleton)
            self._programs[key] = program, structure
        return jax.tree.unflatten(structure, found)

    def _by_name(self, args: tuple, kwargs: dict[str, Any]) -> dict[str, Any]:
        """All arguments by their names, defaults included."""
        if not kwargs and len(args) == len(self._names):  # binding them takes as long as all else here
            return dict(zip(self._names, args, strict=True))
        bound = self._signature.bind(*args, **kwargs)
        bound.apply_defaults()
        return dict(bound.arguments)


_ADDRESS = " at 0x"
"""How a function among the arguments is written. In another process that address says nothing of what it does."""


_SAME_ALWAYS = frozenset(map(np.dtype, (np.float32, np.int32, np.uint8, bool)))
"""Types that JAX takes as they are, whether it counts in 64 bits or not."""


def _array(leaf: Any) -> Any:
    """Arrays and numbers of the host in the type that JAX gives them."""
    if not isinstance(leaf, np.ndarray):
        if isinstance(leaf, jax.Array):
            return leaf
        leaf = np.asarray(leaf)
    if leaf.dtype in _SAME_ALWAYS:
        return leaf
    return leaf.astype(jax.dtypes.canonicalize_dtype(leaf.dtype), copy=False)
