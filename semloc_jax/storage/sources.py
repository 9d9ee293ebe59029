"""What this package is made of, in one number (room: ground; host).

In: the folder of a package. Out: a hash of its sources: what was made by other code is known by it.
"""

import hashlib
from functools import cache
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]
_SOURCES = ("*.py", "native/src/*")
"""All of them, so that no room can be forgotten."""


@cache
def hash_of_sources(package: Path = _PACKAGE) -> str:
    """Hash of the names and contents of all sources of a package."""
    found = hashlib.sha256()
    for path in sorted(path for pattern in _SOURCES for path in package.rglob(pattern)):
        found.update(f"{path.relative_to(package)} {path.stat().st_size}\n".encode())
        found.update(path.read_bytes())
    return found.hexdigest()
