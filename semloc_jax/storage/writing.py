"""Files that are old or new, never half (room: ground; host).

In: content. Out: the file, renamed into place when it is whole; or lines, each on disk before the next begins.
"""

import contextlib
import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from semloc_jax.storage.leftovers import sweep_once, temporary_prefix


@contextlib.contextmanager
def writing(path: str | Path) -> Iterator[Path]:
    """A path beside `path` to write to; it becomes `path` where the block ends without an error, else it goes.

    The temporary file keeps the suffix, by which many writers know the format. The mode is that of the file that is
    replaced, else what the umask of the process leaves. A link is followed: the file it names is replaced. What killed
    processes left in the folder goes first.
    """
    path = Path(path)
    target = path.resolve() if path.is_symlink() else path
    sweep_once(target.parent)
    handle, name = tempfile.mkstemp(prefix=temporary_prefix(target.stem), suffix=target.suffix, dir=target.parent)
    os.close(handle)
    partial = Path(name)
    try:
        yield partial
        partial.chmod(_mode(target))
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def making(path: str | Path) -> Iterator[Path]:
    """A path that is free, of the same name, in a hidden folder beside `path`; what was made there moves to `path`.

    For what writes a folder, insists on a new file or notes its own name in it. `path` must be free.
    """
    path = Path(path)
    sweep_once(path.parent)
    hidden = Path(tempfile.mkdtemp(prefix=temporary_prefix(path.stem), dir=path.parent))
    try:
        yield hidden / path.name
        os.rename(hidden / path.name, path)
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def remove_folder(path: str | Path) -> None:
    """Take a folder away at once, where it is there: a kill while its files go leaves none of it under its name."""
    path = Path(path)
    if not path.is_dir():
        return
    hidden = Path(tempfile.mkdtemp(prefix=temporary_prefix(path.name), dir=path.parent))
    os.rename(path, hidden / path.name)
    shutil.rmtree(hidden, ignore_errors=True)


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a whole file."""
    with writing(path) as partial:
        partial.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a whole text file in UTF-8, with the line ends as they are."""
    write_bytes(path, text.encode("utf-8"))


def write_npz(path: str | Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays as a whole npz file, packed lightly: what is mostly zeros shrinks, and it takes little time."""
    import numpy as np

    with writing(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.asarray(values), allow_pickle=False)


def append_line(path: Path, line: str) -> None:
    """Add one line to a file; it is with the system when this returns, so that a kill cannot take it back.

    A last line that was cut goes first: the new one would be written to its end, and neither could be read.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
    try:
        if os.lseek(handle, 0, os.SEEK_END) and _last_byte(handle) != b"\n":
            os.ftruncate(handle, path.read_bytes().rfind(b"\n") + 1)
        content = line.encode("utf-8") + b"\n"
        while content:  # a full disk takes a part, and tells with the next
            content = content[os.write(handle, content) :]
    finally:
        os.close(handle)


def _last_byte(handle: int) -> bytes:
    os.lseek(handle, -1, os.SEEK_END)
    return os.read(handle, 1)


def whole_lines(path: Path) -> list[str]:
    """Lines of a file that grew line by line; a last one without its end was cut by a kill and is left out."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return []
    return content[: content.rfind(b"\n") + 1].decode("utf-8", "replace").splitlines()


def _mode(path: Path) -> int:
    try:
        return path.stat().st_mode & 0o777
    except OSError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask
