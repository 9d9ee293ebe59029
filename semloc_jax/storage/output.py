"""Where an output file goes, always below the folder of the run, and who may write there (room: ground; host).

In: a folder, and names that come from a recording (frames, cameras, classes). Out: a path inside the folder; a claim on
the folder, which ends with the process however that ends; a sentence where it is taken.
Names of recordings are text of strangers: `/etc/x`, `../..` and `CON` are names like any other and must stay so.
The claim is a lock of the system on the folder itself: no file is left behind, and a kill cannot leave it locked.
"""

import errno
import hashlib
import os
import re
from pathlib import Path

from semloc_jax.errors import SemlocError
from semloc_jax.storage.leftovers import sweep

_UNSAFE = re.compile(r'[\x00-\x1f\x7f<>:"/\\|?*\ud800-\udfff]')
_RESERVED = {"con", "prn", "aux", "nul", *(f"{name}{digit}" for name in ("com", "lpt") for digit in range(1, 10))}
"""Names of devices on Windows."""
_LONGEST = 120
"""Bytes of a name; file systems take 255, and suffixes are added."""


def is_plain_name(text: str) -> bool:
    """Whether a text can be the name of a file as it stands: no folder, no device, no control character."""
    stem = text.split(".", 1)[0].lower()
    is_short = 0 < len(text.encode("utf-8", "replace")) <= _LONGEST
    has_safe_ends = text == text.strip() and not text.startswith(".") and not text.endswith(".")
    return is_short and has_safe_ends and not _UNSAFE.search(text) and stem not in _RESERVED


def file_name(text: str) -> str:
    """The text as the name of a file.

    A plain name stays as it is; any other loses what is unsafe and gains eight digits of its hash, so that two
    different texts never share a file.
    """
    if is_plain_name(text):
        return text
    digest = hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()[:8]
    safe = _UNSAFE.sub("_", text.encode("utf-8", "replace").decode()).strip(". ")
    return f"{safe.encode()[: _LONGEST - 9].decode(errors='ignore')}-{digest}"


def output_path(folder: Path, *names: str, suffix: str = "") -> Path:
    """The path of an output file below a folder; folders on the way are made.

    Args:
        folder: The folder of the run.
        names: Name of each folder below it and of the file, as the recording gives them.
        suffix: Of the file, with its dot.

    Raises:
        SemlocError: a link inside the folder leads out of it.
    """
    parts = [file_name(name) for name in names]
    path = folder.joinpath(*parts[:-1], parts[-1] + suffix)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.parent.resolve().is_relative_to(folder.resolve()):
        raise SemlocError(f"output {path}: a link leads out of {folder}; remove the link or give another --out")
    return path


try:
    import fcntl
except ImportError:  # no such locks on Windows
    fcntl = None

_claims: dict[Path, int] = {}
_TAKEN = (errno.EWOULDBLOCK, errno.EACCES)


def claim(folder: Path) -> None:
    """Claim a folder for this process until `release_claims` or its end; a second claim by the same process is free.

    File systems without locks give none: there the claim does nothing. What a killed run left in the folder goes.

    Raises:
        SemlocError: another process writes to the folder.
    """
    place = folder.resolve()
    if fcntl is None or place in _claims:
        return
    handle = os.open(place, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        if error.errno in _TAKEN:
            raise SemlocError(
                f"output folder {folder}: another run is writing to it; wait for its end or give another --out"
            ) from error
        return
    _claims[place] = handle
    sweep(place)


def release_claims() -> None:
    """Give every folder back that this process has claimed."""
    while _claims:
        os.close(_claims.popitem()[1])
