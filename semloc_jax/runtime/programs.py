"""Compiled programs kept on disk: a new process starts without tracing and compiling (room: runtime; host).

In: a `StoredProgram` and its arguments. Out: its compiled program, loaded where one was stored.
JAX's own compilation cache saves compiling only; tracing and lowering take most of the start of a warm process.
A stored program is code: it is loaded only from a private folder and behind this user's seal (`storage.sealed`).
"""

import functools
import hashlib
import logging
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from semloc_jax.native import build
from semloc_jax.runtime import effort
from semloc_jax.runtime.prepare import versions
from semloc_jax.runtime.stored_program import StoredProgram
from semloc_jax.storage import read_sealed, write_sealed
from semloc_jax.storage.sources import hash_of_sources

_MOST_FILES = 256
_log = logging.getLogger(__name__)


def is_open() -> bool:
    """Whether programs are kept: JAX has a compilation cache on disk, and SEMLOC_PROGRAMS=0 does not switch them off.

    Whoever edits the package is better off without: every edit makes all programs anew, and JAX's own cache knows which
    of them did change.
    """
    return bool(jax.config.jax_compilation_cache_dir) and os.environ.get("SEMLOC_PROGRAMS") != "0"


def is_quick() -> bool:
    """Whether programs are compiled for a run of few frames at present; see `runtime.effort`."""
    return effort.is_quick()


def obtain(program: StoredProgram, static: dict, tree: Any, leaves: list) -> tuple[Callable, Any, tuple]:
    """The program for some arguments, from disk or compiled and written there, the structure of its result, and the
    leaves of the result for these arguments."""
    name = f"{program.__name__}_{_fingerprint(program, static, tree, leaves)}"
    path = _folder() / f"{name}.bin"
    loaded = _load(path, leaves)
    if loaded is not None:
        return loaded

    skeletons = []

    def flat(*flat_leaves: jax.Array) -> tuple:
        result = program.__wrapped__(**jax.tree.unflatten(tree, flat_leaves), **static)
        skeletons.append(jax.tree.map(lambda _: 0, result))
        return tuple(jax.tree.leaves(result))

    flat.__name__ = name
    compiled = _compile_afresh(flat, leaves, effort.options(program.fused))
    skeleton = skeletons[-1]
    _store(path, compiled, skeleton)
    return compiled, skeleton, compiled(*leaves)


def _fingerprint(program: StoredProgram, static: dict, tree: Any, leaves: list) -> str:
    shapes = [(leaf.shape, str(leaf.dtype)) for leaf in leaves]
    options = effort.options(program.fused)
    parts = (program.__module__, options, static, str(tree), shapes, jax.config.jax_enable_x64, _environment())
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:20]


def _folder() -> Path:
    """Where programs are kept, in the folder of JAX's own cache."""
    return Path(jax.config.jax_compilation_cache_dir) / "programs"


@functools.cache
def _environment() -> str:
    """All that a program depends on besides its arguments: versions, flags, devices, the sources of this package."""
    devices = [str(device) for device in jax.devices()]
    settings = (os.environ.get("XLA_FLAGS", ""), build.is_available(), build.processor())
    return repr((sorted(versions().items()), devices, settings, hash_of_sources()))


def _compile_afresh(function: Callable, leaves: list, options: dict[str, Any]) -> Callable:
    """The compiled function, which JAX's cache neither gives nor keeps: what came from there cannot be stored."""
    limit = jax.config.jax_persistent_cache_min_compile_time_secs
    jax.config.update("jax_persistent_cache_min_compile_time_secs", float("inf"))
    try:
        lowered = jax.jit(function).lower(*leaves)
        try:
            return lowered.compile(compiler_options=options)
        except jax.errors.JaxRuntimeError as error:
            if not options:
                raise
            _log.debug("%s: compiled without options (%s)", function.__name__, error)  # they are those of one release
            return lowered.compile()
    finally:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", limit)


def _load(path: Path, leaves: list) -> tuple[Callable, Any, tuple] | None:
    from jax.experimental import serialize_executable

    content = read_sealed(path)
    if content is None:
        return None
    try:
        # Both pickles, this one and that in the payload, were written by `_store`: the seal says so.
        payload, skeleton, parts = pickle.loads(content)
        if not all(build.status(part).available for part in parts):
            return None
        _prepare_linear_algebra()
        in_tree = jax.tree.structure(((0,) * len(leaves), {}))
        out_tree = jax.tree.structure((0,) * len(jax.tree.leaves(skeleton)))
        program = serialize_executable.deserialize_and_load(payload, in_tree, out_tree)
        return program, skeleton, program(*leaves)  # a program that lacks a part says so only when it runs
    except Exception as error:  # whatever is wrong with a stored program, it can be made anew
        _log.debug("program %s: not loaded (%s); compiled anew", path, error)
        return None


@functools.cache
def _prepare_linear_algebra() -> None:
    """Let JAX fill in the addresses of LAPACK, which it does when it lowers a program that calls it, not when it loads
    one: the call would jump to address zero."""
    jax.jit(jax.numpy.linalg.eigvalsh).lower(np.eye(2, dtype=np.float32))


def _store(path: Path, compiled: Any, skeleton: Any) -> None:
    from jax.experimental import serialize_executable

    try:
        payload, _, _ = serialize_executable.serialize(compiled)
        write_sealed(path, pickle.dumps((payload, skeleton, build.loaded_parts())))
        _forget_oldest(path.parent)
    except Exception as error:  # a platform that cannot store programs, a full or read-only disk
        _log.debug("program %s: not stored (%s)", path, error)


def _forget_oldest(folder: Path) -> None:
    files = sorted(folder.glob("*.bin"), key=lambda path: path.stat().st_mtime)
    for path in files[:-_MOST_FILES]:
        path.unlink(missing_ok=True)
