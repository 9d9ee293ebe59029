"""Small results that are worth keeping between processes (room: runtime; host).

In: what a result depends on, a function that finds it. Out: the result, from disk where it was found before.
"""

import hashlib
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import jax

from semloc_jax.storage import write_text


def remembered(kind: str, depends_on: object, files: Iterable[Path], find: Callable[[], Any]) -> Any:
    """What `find` returns (JSON types), found only once for the same arguments and unchanged files.

    Kept beside JAX's compilation cache; without one, and wherever the disk refuses, it is found anew.

    Args:
        kind: Name of the result, for the file.
        depends_on: Anything with a repr that says what the result depends on.
        files: Files that it depends on; size and time of change stand for their content.
        find: Finds the result.
    """
    cache = jax.config.jax_compilation_cache_dir
    if not cache:
        return find()
    stats = [(str(path.resolve()), *_stat(path)) for path in files]
    digest = hashlib.sha256(repr((depends_on, stats)).encode()).hexdigest()[:20]
    path = Path(cache) / "results" / f"{kind}-{digest}.json"
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        pass
    result = find()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(result))
    except OSError:
        pass  # nothing is lost but time
    return result


def _stat(path: Path) -> tuple[int, int]:
    try:
        stat = path.stat()
    except OSError:
        return 0, 0
    return stat.st_mtime_ns, stat.st_size
