"""Pictures wherever a recording keeps them: files, messages of a bag, frames of a video (room: datasets; host).

In: a path or a stored picture. Out: uint8[h w] or uint8[h w 3] in OpenCV's order blue green red.
"""

from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np

from semloc_jax.errors import DamagedPicture, SemlocError
from semloc_jax.storage import MOST_PIXELS

_PNG = b"\x89PNG\r\n\x1a\n"


@runtime_checkable
class StoredPicture(Protocol):
    """A picture inside a recording; its text says where, for messages."""

    def read(self) -> np.ndarray:
        """The picture uint8[h w] or uint8[h w 3], blue green red."""
        ...


def read_picture(stored: Path | StoredPicture) -> np.ndarray:
    """The picture of a file or of a recording, channels as they are stored.

    Raises:
        SemlocError: there is no such file, or it cannot be decoded.
    """
    if not isinstance(stored, Path):
        return stored.read()
    if not stored.is_file():
        raise SemlocError(f"image {stored}: no such file; expected a png or jpg")
    return decode_picture(np.frombuffer(stored.read_bytes(), np.uint8), f"image {stored}")


def decode_picture(data: np.ndarray, where: str) -> np.ndarray:
    """The picture in the bytes of a png or jpg.

    Raises:
        DamagedPicture: the bytes are damaged or of another format.
    """
    if data[:8].tobytes() == _PNG and data.size > 24:
        width, height = (int.from_bytes(data[at : at + 4].tobytes(), "big") for at in (16, 20))
        if not 0 < width * height <= MOST_PIXELS:
            raise DamagedPicture(f"{where}: states {width}x{height} px; expected the size of an image; write it again")
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what is wrong is said below
    try:
        picture = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except cv2.error:  # sizes that no memory holds
        picture = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if picture is None:
        raise DamagedPicture(f"{where}: cannot be decoded ({data.size} bytes); expected a png or jpg")
    return picture


def as_colour(picture: np.ndarray) -> np.ndarray:
    """The picture as uint8[h w 3], blue green red; more than 8 bit are cut to 8."""
    if picture.dtype == np.uint16:
        picture = (picture >> 8).astype(np.uint8)
    if picture.ndim == 2:
        return cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    return picture if picture.shape[2] == 3 else cv2.cvtColor(picture, cv2.COLOR_BGRA2BGR)
