"""How far every pixel lies from the border of each class of its mask (room: perception; host).

In: masks of class ids, their class table. Out: BorderDistances, one signed field for each camera and channel.
Cost maps saturate within a few pixels, as a solver needs it; a null model needs the distance much farther out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.perception.border_mask import SeenBorders, borders_of
from semloc_jax.perception.class_table import ClassTable
from semloc_jax.perception.distance import BLOCK_PX, coarse_signed_distance


@dataclass(frozen=True)
class BorderDistances:
    """Signed distance of every pixel to the border of its class: negative inside of the mask.

    Attributes:
        signed_px: float32[cam channel h w] in pixels of the full mask, clipped at `reach_px`.
        stride: pixels of the full mask in one of the field.
        reach_px: farther than this all is one.
    """

    signed_px: np.ndarray
    stride: int
    reach_px: float


def border_distances(
    masks: Sequence[np.ndarray], table: ClassTable, reach_px: float, stride: int = 2, blur_px: float = 1.0
) -> BorderDistances:
    """The distances of one frame.

    Args:
        masks: class ids, uint8[h w], one for each camera.
        table: the class table of the masks; its channels are those of the fields.
        reach_px: distance at which the fields saturate [px of the full mask].
        stride: 1, 2, 4, 8 or 16.
        blur_px: smoothing along the border [px].
    """
    height, width = (-(-max(mask.shape[axis] for mask in masks) // stride) for axis in (0, 1))
    fields = np.full((len(masks), len(table.channels), height, width), reach_px, np.float32)
    for camera, mask in enumerate(masks):
        bottom, right = (-size % BLOCK_PX for size in mask.shape)
        layers = cv2.copyMakeBorder(cv2.LUT(mask, table.layer_numbers), 0, bottom, 0, right, cv2.BORDER_REPLICATE)
        seen = borders_of(mask)
        if seen is not None:
            _fill_seen(fields[camera], seen, mask.shape, table, stride, reach_px)
        for index, channel in enumerate(table.channels):
            if seen is not None and channel.name in seen.names:
                continue
            binary = cv2.compare(layers, index + 1, cv2.CMP_EQ)
            box = _within_reach(binary, reach_px)
            if box is None:
                continue
            distance = coarse_signed_distance(np.ascontiguousarray(binary[box]), stride, blur_px)
            top, left = (side.start // stride for side in box)
            rows, columns = -(-mask.shape[0] // stride) - top, -(-mask.shape[1] // stride) - left
            near = np.clip(distance[:rows, :columns], -reach_px, reach_px)
            fields[camera, index, top : top + len(near), left : left + near.shape[1]] = near
    return BorderDistances(fields, stride, reach_px)


def _fill_seen(
    fields: np.ndarray, seen: SeenBorders, shape: tuple[int, ...], table: ClassTable, stride: int, reach_px: float
) -> None:
    """Write the distances that a network tells, [channel h w]; what is beyond its reach is beyond ours."""
    rows, columns = -(-shape[0] // stride), -(-shape[1] // stride)
    for index, channel in enumerate(table.channels):
        if channel.name in seen.names:
            told = seen.signed_px[seen.names.index(channel.name)]
            told = np.where(told < 0.95 * seen.reach_px, told, reach_px)
            near = np.clip(seen.at(told, (columns, rows), stride), -reach_px, reach_px)
            fields[index, :rows, :columns] = near


def _within_reach(binary: np.ndarray, reach_px: float) -> tuple[slice, slice] | None:
    """The part of a layer, at multiples of BLOCK_PX, outside of which every pixel is farther from it than the reach;
    None where the layer is empty."""
    x, y, width, height = cv2.boundingRect(binary)
    if not width:
        return None
    # Two pixels more: the smoothing moves a border by a share of one.
    beyond = reach_px + 2.0
    rows, columns = (
        slice(max(int((first - beyond) // BLOCK_PX), 0) * BLOCK_PX, -int(-(last + beyond) // BLOCK_PX) * BLOCK_PX)
        for first, last in ((y, y + height), (x, x + width))
    )
    return slice(rows.start, min(rows.stop, binary.shape[0])), slice(columns.start, min(columns.stop, binary.shape[1]))


def pixel_unit(shapes: Sequence[tuple[int, ...]]) -> float:
    """How many pixels of these masks (height, width) stand for one of a usual image; 1 for 550 px on a side and more.

    Borders are blurred by about as many pixels in all images that are large enough; small ones are made of larger ones,
    and their borders are sharper by the same ratio.
    """
    side_px = max(float(np.sqrt(shape[0] * shape[1])) for shape in shapes)
    return float(np.clip(side_px / 550.0, 0.3, 1.0))
