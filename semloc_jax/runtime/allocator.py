"""Memory of a process that runs for hours (room: runtime; host).

In: nothing. Out: an allocator that gives large blocks back to the system as soon as they are free; blocks that are used
again.
"""

import ctypes
import functools
import sys
import threading

import numpy as np

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Of glibc's malloc.h."""
_LARGE_BYTES = 1 << 25
"""The most that glibc allows. What is smaller stays in the heap: the system clears every page of a new block, which at
2**18 took a sixth of a tracked drive and at 2**22 2,000 page faults a frame of four fisheyes (30 with this). 2,040
frames of them take 50 MiB more, the most of it within the first hundred."""
_KEPT_BYTES = 1 << 25
"""Free memory that the end of the heap keeps. A program that sets one threshold stops glibc from learning the other:
at its 128 kB the pages of every array of a megabyte would be given back, and cleared anew for the next one (180 arrays
of 1 to 2 MB: 33,240 page faults; with this 554)."""


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
        mallopt = ctypes.CDLL(None).mallopt
        return bool(mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES) and mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES))
    except (OSError, AttributeError):  # another C library
        return False


ALIGN_BYTES = 64
"""JAX on the CPU copies what is aligned less, and takes over the rest."""
_MOST_BLOCKS = 16
_NOBODY = next(sys.getrefcount(block) for block in [np.empty(0, np.uint8)])
"""References to a block that only a list knows, counted as below: Python versions differ in which they count."""
_blocks: list[np.ndarray] = []
_lock = threading.Lock()


def used_again(num_bytes: int) -> np.ndarray:
    """Aligned memory of any content, `uint8[num_bytes]`, of a block that nobody looks at any more, or of a new one.

    A new block of some megabytes costs more than what is written into it: the system clears every page at its first
    touch. Whoever holds the array, a view of it, or a JAX array that took it over keeps the block.
    """
    with _lock:
        size = num_bytes + ALIGN_BYTES
        block = next((b for b in _blocks if b.size == size and sys.getrefcount(b) == _NOBODY), None)
        if block is None:
            block = np.empty(size, np.uint8)
            _blocks.append(block)
            if len(_blocks) > _MOST_BLOCKS:
                del _blocks[0]
        start = -block.ctypes.data % ALIGN_BYTES
        return block[start : start + num_bytes]
