"""Masks of a drive by a network, with a picture to judge them by eye (room: reports; host).

In: a drive, a network. Out: the folder of `segment_drive`, look.jpg in it.
"""

from pathlib import Path

import cv2
import numpy as np

from semloc_jax.datasets import Drive, Frame
from semloc_jax.inputs.segmentation import Segmented, segment_drive
from semloc_jax.perception import ClassTable, load_class_table, read_mask
from semloc_jax.perception.network import NetworkPreset
from semloc_jax.viz.overlay import mask_picture
from semloc_jax.viz.style import save, sheet

LOOK = "look.jpg"
_SHOWN, _WIDTH_PX = 10, 640


def report_segmentation(
    drive: Drive,
    preset: NetworkPreset,
    chosen: slice = slice(None),
    cameras: tuple[str, ...] | None = None,
    folder: Path | None = None,
    map_path: Path | None = None,
    overwrite: bool = False,
) -> Segmented:
    """Make the masks that are missing, see `segment_drive`, and a picture of ten of them on their images."""
    made = segment_drive(drive, preset, chosen, cameras, folder, map_path, overwrite)
    pairs = [(frame, camera) for frame in drive.frames[chosen] for camera in made.cameras]
    pairs = [(frame, camera) for frame, camera in pairs if _mask_path(made, frame, camera).is_file()]
    if not pairs:
        return made
    shown = [pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, min(_SHOWN, len(pairs))).astype(int))]
    table = load_class_table(preset.class_table)
    tiles = [_tile(frame.image(camera), read_mask(_mask_path(made, frame, camera)), table) for frame, camera in shown]
    save(sheet(tiles), made.folder / LOOK)
    return made._replace(text=f"{made.text}\nlook at {made.folder / LOOK}")


def _mask_path(made: Segmented, frame: Frame, camera: str) -> Path:
    return made.folder / camera / f"{frame.id}.png"


def _tile(image: np.ndarray, mask: np.ndarray, table: ClassTable) -> np.ndarray:
    """An image with its mask over it, red green blue, of one width."""
    height = round(_WIDTH_PX * image.shape[0] / image.shape[1])
    size = (_WIDTH_PX, height)
    below = cv2.resize(image[..., ::-1], size, interpolation=cv2.INTER_AREA)
    ids = cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)
    shown = np.isin(ids, [number for channel in table.channels for number in channel.mask_ids] + [*table.unusable_ids])
    over = np.minimum(mask_picture(ids, table).astype(np.float32) / 0.55, 255.0)
    mixed = np.where(shown[..., None], 0.25 * below + 0.75 * over, 0.8 * below)
    return mixed.astype(np.uint8)
