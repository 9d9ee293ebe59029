"""How much of a plan falls on itself when it is shifted, by the native kernels (room: native; host).

In: cells of points, their classes and lengths. Out: sums for shifts along each axis.
"""

import ctypes

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.native import build


def overlap_along_axes(
    cell: Int[np.ndarray, "n 2"],
    channel: Int[np.ndarray, " n"],
    length_m: Float[np.ndarray, " n"],
    reach: tuple[int, int],
    band: int,
) -> tuple[Float[np.ndarray, "band shift"], Float[np.ndarray, "band shift_"]]:
    """Length on length of its class at shifts of up to `reach` cells along the first axis and `band` cells across it,
    and the same along the second axis.

    Args:
        cell: Of each point, not negative.
        channel: Of each point, not negative.
        length_m: What it counts.
        reach: Largest shift along each axis.
        band: Largest shift across it.
    """
    order = np.argsort(channel, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(channel))]).astype(np.int32)
    cells, lengths = (np.ascontiguousarray(a[order], kind) for a, kind in ((cell, np.int32), (length_m, np.float32)))
    size = (cells.max(axis=0, initial=0) + 1).astype(np.int32)
    along, across = (np.zeros((2 * band + 1, 2 * most + 1), np.float32) for most in reach)
    reaches = np.array(reach, np.int32)
    pointers = [ctypes.c_void_p(array.ctypes.data) for array in (starts, cells, lengths, size, reaches)]
    sums = [ctypes.c_void_p(array.ctypes.data) for array in (along, across)]
    build.library().semloc_overlap(ctypes.c_int32(len(starts) - 1), *pointers, ctypes.c_int32(band), *sums)
    return along, across
