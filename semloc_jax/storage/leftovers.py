"""What a kill leaves behind goes away with the next write (room: ground; host).

In: a folder. Out: the same folder without temporary files and folders of this package whose process has ended.
The name of each says which process made it; whatever has another name is not ours and stays.
"""

import contextlib
import functools
import hashlib
import os
import re
import shutil
import socket
import stat
import time
from pathlib import Path

_OURS = re.compile(r"\..*~semloc-([0-9a-f]{6})-([0-9]{1,9})-[a-z0-9_]{8}(?:\..*)?", re.DOTALL)
"""Hidden; journals that SQLite keeps beside its file have a longer suffix."""
_LONGEST_STEM = 40
_OLD_S = 86400.0
"""Of another machine it cannot be known which processes live there: what was not touched for a day is left over."""
_swept: set[Path] = set()


def temporary_prefix(stem: str) -> str:
    """How the name of a temporary file or folder of this process begins; `tempfile` adds eight characters."""
    return f".{stem[:_LONGEST_STEM]}~semloc-{_machine()}-{os.getpid()}-"


def sweep(folder: Path) -> None:
    """Remove what ended processes of this package left in a folder; folders below it are not looked into."""
    _swept.add(folder)
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            match = _OURS.fullmatch(entry.name)
            if match and _is_left_over(entry, *match.groups()):
                _remove(entry)


def sweep_once(folder: Path) -> None:
    """The same, once for each folder that this process writes to: folders of masks hold many thousand files."""
    if folder not in _swept:
        sweep(folder)


def _is_left_over(entry: os.DirEntry[str], machine: str, pid: str) -> bool:
    if machine == _machine() and os.name == "posix":  # elsewhere signal 0 is no question
        return not _lives(int(pid))
    try:
        return time.time() - entry.stat(follow_symlinks=False).st_mtime > _OLD_S
    except OSError:
        return False


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # of another user
        return True
    return True


def _remove(entry: os.DirEntry[str]) -> None:
    with contextlib.suppress(OSError):  # another process may sweep too, or the file is another user's
        if stat.S_ISDIR(entry.stat(follow_symlinks=False).st_mode):
            shutil.rmtree(entry.path, ignore_errors=True)
        else:
            os.unlink(entry.path)


@functools.cache
def _machine() -> str:
    """Six digits for this machine and, on Linux, for the container: process numbers mean nothing elsewhere."""
    try:
        numbers = os.readlink("/proc/self/ns/pid")
    except OSError:
        numbers = ""
    return hashlib.sha256(f"{socket.gethostname()} {numbers}".encode()).hexdigest()[:6]
