"""What cells made before, kept beside the map (room: mapping; host).

In: names that say all that a cell was made of. Out: the bytes that it made. A name holds the hash of the drives, of
what they were laid on, and of the code: what another version of this package made is never taken for its own.
"""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

from semloc_jax.maps.versions.history import history_of
from semloc_jax.maps.versions.records import json_bytes
from semloc_jax.storage import write_bytes
from semloc_jax.storage.sources import hash_of_sources

_FOLDER, _SUFFIX = "cells", ".cell"


class KeptCells:
    """The cells that a map file keeps; without a file, none."""

    def __init__(self, path: Path | None, before: Path | None = None):
        """Those beside a map file, and beside the one that it is made of."""
        self._folder = None if path is None else history_of(path) / _FOLDER
        self._before = None if before is None else history_of(before) / _FOLDER
        self._used: set[str] = set()

    def get(self, name: str) -> bytes | None:
        """What was kept under a name."""
        self._used.add(name)
        places = [folder / f"{name}{_SUFFIX}" for folder in (self._folder, self._before) if folder is not None]
        return next((path.read_bytes() for path in places if path.is_file()), None)

    def put(self, name: str, content: bytes) -> None:
        """Keeps what a cell made."""
        self._used.add(name)
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            write_bytes(self._folder / f"{name}{_SUFFIX}", content)

    def drop_others(self) -> None:
        """Lets go of what was neither asked for nor put: cells as they were before."""
        if self._folder is not None and self._folder.is_dir():
            for path in self._folder.glob(f"*{_SUFFIX}"):
                if path.name.removesuffix(_SUFFIX) not in self._used:
                    path.unlink(missing_ok=True)


def name_of(*parts: object) -> str:
    """One name for all that decides what comes out."""
    return hashlib.sha256(json_bytes([_code(), *(repr(part) for part in parts)])).hexdigest()


@cache
def _code() -> str:
    """Hash of the code, and of the libraries that do its sums."""
    libraries = [(name, version(name)) for name in ("numpy", "scipy", "shapely")]
    return hashlib.sha256(repr((libraries, hash_of_sources())).encode()).hexdigest()
