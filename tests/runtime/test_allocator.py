"""What the heap keeps and gives back, in page faults: each is a page that the system has cleared."""

import subprocess
import sys

import pytest

_FAULTS = """
import resource
import numpy as np
from semloc_jax.runtime.allocator import return_large_blocks

assert return_large_blocks() or exit(77)

def faults(num_bytes):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        np.ones(num_bytes // 8)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

faults(1 << 23)
print(faults(1 << 23), faults(1 << 26))
"""


def test_arrays_of_megabytes_use_the_same_pages_again_and_larger_ones_are_given_back():
    """20 arrays of 8 MB, of 2,048 pages each, and of 64 MB."""
    done = subprocess.run([sys.executable, "-c", _FAULTS], capture_output=True, text=True)
    if done.returncode == 77:
        pytest.skip("another C library")
    assert done.returncode == 0, done.stderr
    kept, given_back = map(int, done.stdout.split())
    assert kept < 20 * 50
    assert given_back >= 20  # at least: with huge pages a fault clears 512 of them
