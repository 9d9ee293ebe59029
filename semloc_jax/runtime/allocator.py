"""Memory of a process that runs for hours (room: runtime; host).

In: nothing. Out: an allocator that gives large blocks back to the system as soon as they are free.
"""

import ctypes
import functools
import sys

_M_MMAP_THRESHOLD = -3
"""Of glibc's malloc.h."""
_LARGE_BYTES = 1 << 18
"""Images and cost maps are larger; ours."""


@functools.cache
def return_large_blocks() -> bool:
    """Whether this process now returns every large block to the system when it is freed; True on Linux with glibc.

    By itself glibc learns from the first large blocks that are freed to cut later ones from its heap. Cost maps of
    several frames in flight leave that heap in pieces: measured, it grew with every frame by the size of its
    cost maps.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        return bool(ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES))
    except (OSError, AttributeError):  # another C library
        return False
