"""What poses see of the map, sample by sample, by the native kernels (room: native; host).

In: poses, samples, a camera, distances to mask borders. Out: one row for each pose and sample that it sees.
"""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from semloc_jax.native import build


class Rows(NamedTuple):
    """What is seen, pose by pose."""

    pose: Int[np.ndarray, " row"]
    sample: Int[np.ndarray, " row"]
    cell: Int[np.ndarray, " row"]
    signed_px: Float[np.ndarray, " row"]
    length_px: Float[np.ndarray, " row"]
    range_m: Float[np.ndarray, " row"]


class Field(NamedTuple):
    """One camera: distances to the borders of its masks, pixels that may be used, each at its stride."""

    signed_px: Float[np.ndarray, "channel h w"]
    stride: float
    usable: Bool[np.ndarray, "uh uw"]
    usable_stride: float


def rows_seen(
    part: str,
    camera: Sequence[np.ndarray],
    T_base_cam: Float[np.ndarray, "4 4"],
    Ts_local_base: Float[np.ndarray, "n 4 4"],
    samples: Sequence[np.ndarray],
    channel_of_label: Int[np.ndarray, " label"],
    num_ground: int,
    field: Field,
    limits: tuple[float, float, float, float],
    cell_columns: int,
) -> Rows:
    """The samples that each pose sees through one camera.

    Args:
        part: Class of the camera in native/src/cameras.h, whose part is loaded.
        camera: Leaves of the camera, in their order.
        T_base_cam: Extrinsics.
        Ts_local_base: Poses relative to the local origin.
        samples: Leaves of the MapSamples, in their order.
        channel_of_label: Negative where no mask shows the class.
        num_ground: So many of the first labels are painted on the ground.
        field: Of this camera.
        limits: Margin at the border of the image [px], largest range [m], least pixels for a metre on the ground, size
            of a cell [px].
        cell_columns: Cells of one row of the image.
    """
    floats = [np.ascontiguousarray(leaf, np.float32) for leaf in camera]
    kinds = [np.float32] * 4 + [np.int32] * 3 + [np.float32] * 2 + [np.uint8]
    columns = [np.ascontiguousarray(leaf).astype(kind, copy=False) for leaf, kind in zip(samples, kinds, strict=True)]
    mount, poses = (np.ascontiguousarray(T, np.float32) for T in (T_base_cam, Ts_local_base))
    channels, signed = np.ascontiguousarray(channel_of_label, np.int32), np.ascontiguousarray(field.signed_px)
    usable = np.ascontiguousarray(field.usable).view(np.uint8)
    sizes = np.array([*signed.shape[1:], *usable.shape], np.int32)
    numbers = np.array([field.stride, field.usable_stride, *limits], np.float32)
    # What is not seen is never written: its memory stays untouched.
    most = len(poses) * len(columns[3])
    whole, real = ([np.empty(most, kind) for _ in range(3)] for kind in (np.int32, np.float32))
    count = _observe(part)(
        _pointers(floats),
        *(array.ctypes.data for array in (mount, poses)),
        len(poses),
        _pointers(columns),
        len(columns[3]),
        channels.ctypes.data,
        num_ground,
        *(array.ctypes.data for array in (signed, usable, sizes, numbers)),
        cell_columns,
        _pointers(whole),
        _pointers(real),
    )
    return Rows(*(array[:count] for array in (*whole, *real)))


def add_gains(
    part: str,
    camera: Sequence[np.ndarray],
    T_base_cam: Float[np.ndarray, "4 4"],
    Ts_local_base: Float[np.ndarray, "n 4 4"],
    samples: tuple[Float[np.ndarray, "3 p"], Int[np.ndarray, " p"], Float[np.ndarray, " p"]],
    gain: Float[np.ndarray, "channel h w"],
    numbers: tuple[float, float, float],
    nats: Float[np.ndarray, " n"],
) -> None:
    """Adds to each pose what samples gain by the pixels of one camera that they fall on.

    Args:
        part, camera, T_base_cam, Ts_local_base: As `rows_seen`.
        samples: Position relative to the local origin [m], channel and weight of each.
        gain: Float32.
        numbers: Stride of the gain, margin at the border of the image [px], largest range [m].
        nats: Float32, added to.
    """
    floats = [np.ascontiguousarray(leaf, np.float32) for leaf in camera]
    mount, poses, p_map, weight, gain, known = (
        np.ascontiguousarray(array, np.float32)
        for array in (T_base_cam, Ts_local_base, samples[0], samples[2], gain, numbers)
    )
    channel, sizes = np.ascontiguousarray(samples[1], np.int32), np.array(gain.shape[1:], np.int32)
    pointer, number = ctypes.c_void_p, ctypes.c_int32
    call = build.library(part).semloc_coarse_look
    call.restype = None
    call.argtypes = [pointer, pointer, pointer, number, *[pointer] * 3, number, *[pointer] * 4]
    call(
        _pointers(floats),
        *(array.ctypes.data for array in (mount, poses)),
        len(poses),
        *(array.ctypes.data for array in (p_map, channel, weight)),
        len(channel),
        *(array.ctypes.data for array in (gain, sizes, known, nats)),
    )


def _observe(part: str) -> ctypes._CFuncPtr:
    call = build.library(part).semloc_observe
    pointer, number = ctypes.c_void_p, ctypes.c_int32
    call.restype = ctypes.c_int64
    call.argtypes = [pointer, pointer, pointer, number, pointer, number, pointer, number, *[pointer] * 4, number]
    call.argtypes = [*call.argtypes, pointer, pointer]
    return call


def _pointers(arrays: Sequence[np.ndarray]) -> ctypes.Array:
    return (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))
