"""The ramps of a mask as bytes, and bytes as texels, by the native kernels (room: native; host).

In: layers of a mask, levels, how the border is smoothed. Out: bytes 0 .. 254 that span [-1, 1], written in place;
texels as `residuals.texture` has them.
"""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8, UInt32

from semloc_jax.native import build

MOST_REACH_PX = 127
"""Pixels of the reduced mask that a ramp may reach: distances along a column are bytes."""
MOST_BLUR_PX = 1.24
"""Beyond, lines of two pixels are thin, too; the kernel knows those of one."""


class Smoothing(NamedTuple):
    """How a mask of some stride becomes a distance near its border; see `perception.distance`."""

    blur_px: float
    keep: Float[np.ndarray, "256"]
    add: Float[np.ndarray, "256"]
    half_px: float
    outset_px: float


class LevelBytes(NamedTuple):
    """One level of one channel."""

    bytes: UInt8[np.ndarray, "h w"]
    """Rows may lie apart, the pixels of a row not."""
    stride: int
    ramp_px: float


def reaches(levels: Sequence[LevelBytes], smoothing: Smoothing, stride: int) -> bool:
    """Whether the kernel can do these levels."""
    reach = max(level.ramp_px + level.stride for level in levels) / stride + 3
    return reach <= MOST_REACH_PX and 0 < smoothing.blur_px <= MOST_BLUR_PX


def write_mask_ramps(
    layers: UInt8[np.ndarray, "h w"], value: int, stride: int, smoothing: Smoothing, levels: Sequence[LevelBytes]
) -> None:
    """Write the ramps of one value of a mask into all levels whose stride is a multiple of `stride`.

    Args:
        layers: The mask, contiguous, height and width multiples of every stride.
        value: Pixels of this value are inside.
        stride: Pixels of the mask in one of those in which distances are measured.
        smoothing: For that stride.
        levels: What is written; pixels far from the value are left as they are.
    """
    planes = (ctypes.c_void_p * len(levels))(*(level.bytes.ctypes.data for level in levels))
    shapes = np.array([(*level.bytes.shape, level.bytes.strides[0], level.stride) for level in levels], np.int32)
    ramps = np.array([level.ramp_px for level in levels], np.float32)
    keep, add = (np.ascontiguousarray(table, np.float32) for table in (smoothing.keep, smoothing.add))
    build.library().semloc_mask_ramps(
        ctypes.c_void_p(layers.ctypes.data),
        *(ctypes.c_int32(number) for number in (*layers.shape, value, stride)),
        ctypes.c_float(smoothing.blur_px),
        ctypes.c_void_p(keep.ctypes.data),
        ctypes.c_void_p(add.ctypes.data),
        ctypes.c_float(smoothing.half_px),
        ctypes.c_float(smoothing.outset_px),
        ctypes.c_int32(len(levels)),
        planes,
        ctypes.c_void_p(shapes.ctypes.data),
        ctypes.c_void_p(ramps.ctypes.data),
    )


def packed(ramps: Sequence[UInt8[np.ndarray, "cam channel _h _w"]], texels: UInt32[np.ndarray, " texel"]) -> None:
    """Write the texels of all levels, one after another, as `residuals.texture.pack` has them.

    Args:
        ramps: Bytes of each level, contiguous.
        texels: As many as all levels have pixels.
    """
    planes = (ctypes.c_void_p * len(ramps))(*(ramp.ctypes.data for ramp in ramps))
    counts, widths = (np.array(sizes, np.int64) for sizes in zip(*((r.size, r.shape[3]) for r in ramps), strict=True))
    build.library().semloc_pack_bytes(
        ctypes.c_int32(len(ramps)),
        planes,
        ctypes.c_void_p(counts.ctypes.data),
        ctypes.c_void_p(widths.ctypes.data),
        ctypes.c_void_p(texels.ctypes.data),
    )
