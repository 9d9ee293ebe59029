"""Paths that stay valid while a run writes its results (room: inputs; host).

In: options that name files or folders. Out: the same options, with the link `results/latest` followed.
"""

import dataclasses
from pathlib import Path
from typing import Any, TypeVar

LATEST = "latest"
"""Name of the link in the folder of results that points to the newest run."""

Options = TypeVar("Options")


def pinned(path: Path) -> Path:
    """The path with links among its parents followed, so that moving a link later does not change what it names.

    A path that does not exist, and one without links, stay as given.
    """
    try:
        if not path.exists():
            return path
    except OSError:  # too long for the file system: the reader says what is wrong with it
        return path
    parent = path.parent.resolve()
    fixed = parent / path.name
    if path.name == LATEST and path.is_symlink():
        return fixed.resolve()
    return path if parent == path.parent.absolute() else fixed


def pinned_options(options: Options) -> Options:
    """The dataclass with every path in it pinned, whether it is held as a Path, as text or in a tuple.

    The field `out` stays: it names what is written.
    """
    changed = {}
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        fixed = value if field.name == "out" else _pinned_value(value)
        if fixed != value:
            changed[field.name] = fixed
    return dataclasses.replace(options, **changed) if changed else options


def _pinned_value(value: Any) -> Any:
    if isinstance(value, Path):
        return pinned(value)
    # A text without a separator is a name (gnss, sem_net), not a path.
    if isinstance(value, str) and "/" in value:
        fixed = pinned(Path(value))
        return value if fixed == Path(value) else str(fixed)
    if isinstance(value, tuple):
        return tuple(_pinned_value(item) for item in value)
    return value
