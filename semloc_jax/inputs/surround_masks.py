"""Do the masks of a surround view fit its cameras? (room: inputs; host).

In: a drive, masks of its cameras. Out: what is to be said of them; what cannot be used is refused in one line.
"""

import cv2
import numpy as np
from jaxtyping import UInt8

from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import looked_at
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.perception.camera_order import belonging, named_order
from semloc_jax.perception.surround import PAINT, SurroundView

_SIZE_M, _PX_M = 10.0, 0.04
_PAINTED, _BARE, _ELSE = 235, 120, 40
_SAME_ASPECT = 0.02
"""Masks of another size than the image keep its aspect so nearly."""


def check_surround_masks(drive: Drive, masks: MaskSource) -> list[str]:
    """What is to be said of the masks of a surround view, one sentence each.

    Raises:
        SemlocError: a camera whose masks show one class only, whose masks have another shape than its images, or masks
            that lie in another order than the cameras.
    """
    rig, frames = drive.rig.select(masks.cameras), looked_at(drive.frames)
    shown = [masks.masks(frame) for frame in frames]
    for index, (name, camera) in enumerate(zip(rig.names, rig.cameras, strict=True)):
        where = f"drive {drive.name}: masks '{masks.name}' of camera {name}"
        others = ",".join(other for other in rig.names if other != name)
        ids = np.unique(np.concatenate([np.unique(own[index]) for own in shown]))
        if len(ids) < 2:
            raise SemlocError(
                f"{where} show nothing but id {ids[0]} in {len(frames)} frames; go without: --cameras {others}"
            )
        height, width = shown[0][index].shape
        aspect = width / height * camera.resolution[1] / camera.resolution[0]
        if abs(aspect - 1.0) > _SAME_ASPECT:
            told = "{}x{}".format(*camera.resolution)
            raise SemlocError(
                f"{where} have {width}x{height} px, the calibration says {told}; give the calibration of these masks "
                "(of another car?)"
            )
    _refuse_another_order(drive, masks, shown)
    missing = [name for name in drive.rig.names if name not in masks.cameras]
    return [f"without camera {', '.join(missing)}: no masks '{masks.name}' of it, or not chosen"] if missing else []


def _refuse_another_order(drive: Drive, masks: MaskSource, shown: list[list[np.ndarray]]) -> None:
    """Neighbours show the same paint in their overlaps."""
    rig = masks.camera_rig(drive.rig.select(masks.cameras))
    if len(rig) < 3:
        return
    grey = np.full(256, _ELSE, np.uint8)
    for channel in masks.table.channels:
        if set(channel.classes) & PAINT:
            grey[list(channel.mask_ids)] = _PAINTED
    grey[[number for number, name in masks.table.id_names.items() if name == "road"]] = _BARE
    view = SurroundView.around(rig, _SIZE_M, _PX_M)
    order = belonging(view, [[_picture(grey, mask) for mask in own] for own in shown]).better_order
    if order is not None:
        raise SemlocError(
            f"drive {drive.name}: masks '{masks.name}' lie in another order than the cameras: "
            f"{named_order(rig.names, order)}; rename their folders"
        )


def _picture(grey: UInt8[np.ndarray, "256"], mask: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    return cv2.cvtColor(grey[np.asarray(mask)], cv2.COLOR_GRAY2BGR)
