"""Results that are worth keeping: between processes on disk, or for the object they were made from (room: runtime;
host).

In: what a result depends on, a function that finds it. Out: the result, which is found once.
"""

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable, Iterable
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

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


Result = TypeVar("Result")
_KEPT = 16
"""Results of each function: those of one drive, whose frames share their rig."""


def once_for_each(function: Callable[..., Result]) -> Callable[..., Result]:
    """Decorator: the last results, by the identity of the first argument, which must not change, and the others."""
    kept: OrderedDict[tuple, tuple[object, Result]] = OrderedDict()

    @wraps(function)
    def remembered(first: object, *others: object) -> Result:
        key = (id(first), *others)
        if key not in kept:
            kept[key] = first, function(first, *others)  # with the object, so that no other one gets its id
            while len(kept) > _KEPT:
                kept.popitem(last=False)
        return kept[key][1]

    return remembered
