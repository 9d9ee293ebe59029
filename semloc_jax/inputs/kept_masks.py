"""Masks that take their time are made once (room: inputs; host).

In: a MaskSource whose masks are looked at many times, as while a map is made. Out: one that keeps them in a folder.
"""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from semloc_jax.datasets import Frame
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.perception.border_mask import BorderMask
from semloc_jax.perception.masks import read_mask
from semloc_jax.storage import output_path, write_bytes

_QUICK = (cv2.IMWRITE_PNG_COMPRESSION, 1)


def kept(source: MaskSource, folder: Path) -> MaskSource:
    """The same masks, each made at its first look and read from the folder after that.

    Masks that say more than class ids (distances to borders, their sigmas) are not kept. Frames are told apart by their
    ids, so this is for the frames of one drive.

    Args:
        source: Masks of a drive.
        folder: For these masks alone; those of a run that was killed are taken again.
    """

    def segment(frame: Frame, camera: str) -> np.ndarray:
        path = output_path(folder, camera, frame.id, suffix=".png")
        if path.is_file():
            return read_mask(path)
        mask = source.segment(frame, camera)
        if not isinstance(mask, BorderMask):
            write_bytes(path, cv2.imencode(".png", mask, _QUICK)[1].tobytes())
        return mask

    return replace(source, segment=segment)
