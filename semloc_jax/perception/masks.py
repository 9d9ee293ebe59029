"""Semantic masks from files (room: perception; host).

In: single-channel PNG files of class ids. Out: uint8[h w] masks; the class table that reads them is in class_table.
"""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

from semloc_jax.errors import DamagedPicture, SemlocError
from semloc_jax.perception.class_table import Channel, ClassTable, TableReport, load_class_table, preset_names
from semloc_jax.perception.mask_offset import MaskOffset, estimate_mask_offset
from semloc_jax.storage import MOST_PIXELS

__all__ = [
    "Channel",
    "ClassTable",
    "MaskOffset",
    "TableReport",
    "estimate_mask_offset",
    "load_class_table",
    "preset_names",
    "read_mask",
]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY = 0
_LAYOUTS = {2: "RGB colour", 4: "grey with alpha", 6: "RGB with alpha"}


def read_mask(path: str | Path, size_px: tuple[int, int] | None = None) -> np.ndarray:
    """The class ids of a mask file, uint8[h w].

    Args:
        path: single-channel 8-bit PNG; a palette image gives its indices.
        size_px: (width, height) that the mask must have, None for any.

    Raises:
        SemlocError: the file is missing, damaged, in colour, deeper than 8 bit, or of another size.
    """
    path = Path(path)
    if not path.is_file():
        raise SemlocError(f"mask {path}: no such file; masks are single-channel PNG files of class ids")
    data = path.read_bytes()
    if not data.startswith(_SIGNATURE):
        raise SemlocError(f"mask {path}: not a PNG file; class ids survive only in a loss-free format, write PNG")
    damaged = DamagedPicture(f"mask {path}: the file is cut off or damaged ({len(data)} bytes); write it again")
    chunks = _chunks(data)
    if chunks is None or len(chunks[0][1]) < 13:
        raise damaged
    depth, layout = chunks[0][1][8:10]
    if layout in _LAYOUTS or depth > 8:
        given = f"{_LAYOUTS.get(layout, 'grey')}, {depth} bit"
        raise SemlocError(
            f"mask {path}: given {given}, expected one 8-bit channel of class ids; "
            "a colour picture of the classes is not a mask: map its colours back to ids first"
        )
    width, height = struct.unpack_from(">II", chunks[0][1])
    if not 0 < width * height <= MOST_PIXELS:
        raise SemlocError(f"mask {path}: states {width}x{height} px; expected the size of an image; write it again")
    try:
        mask = cv2.imdecode(np.frombuffer(_as_grey(chunks), np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        mask = None
    if mask is None or mask.ndim != 2:
        raise damaged
    if depth < 8:
        # The decoder stretches 1, 2 and 4 bit values to 0...255; ids must not change.
        mask //= 255 // (2**depth - 1)
    if size_px is not None and mask.shape[::-1] != tuple(size_px):
        given = f"{mask.shape[1]}x{mask.shape[0]}"
        raise SemlocError(
            f"mask {path}: given {given} px, expected {size_px[0]}x{size_px[1]} px as in the calibration; "
            "resize the camera (Camera.resized) or write masks at the size of the images"
        )
    return mask


def _chunks(data: bytes) -> list[tuple[bytes, bytes]] | None:
    """Type and content of every PNG chunk; None if a chunk is damaged or the end is missing."""
    chunks, at = [], len(_SIGNATURE)
    while at + 12 <= len(data):
        (size,) = struct.unpack_from(">I", data, at)
        kind, content = data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        checksum = data[at + 8 + size : at + 12 + size]
        if len(checksum) < 4 or struct.unpack(">I", checksum)[0] != zlib.crc32(kind + content):
            return None
        chunks.append((kind, content))
        if kind == b"IEND":
            return chunks if chunks[0][0] == b"IHDR" else None
        at += 12 + size
    return None


def _as_grey(chunks: list[tuple[bytes, bytes]]) -> bytes:
    """The same picture as a plain grey PNG, so that a palette decodes to its indices instead of its colours."""
    parts = [_SIGNATURE]
    for kind, content in chunks:
        if kind == b"IHDR":
            content = content[:9] + bytes([_GREY]) + content[10:]
        elif kind not in (b"IDAT", b"IEND"):
            continue
        parts += [struct.pack(">I", len(content)), kind, content, struct.pack(">I", zlib.crc32(kind + content))]
    return b"".join(parts)
