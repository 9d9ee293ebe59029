"""One run at a time writes to a folder (room: ground; host).

In: an output folder. Out: a claim on it, which ends with the process however that ends; a sentence where it is taken.
The claim is a lock of the system on the folder itself: no file is left behind, and a kill cannot leave it locked.
"""

import errno
import os
from pathlib import Path

from semloc_jax.errors import SemlocError
from semloc_jax.storage.leftovers import sweep

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
