"""Borders of masks on which no contour of the map lies (room: alignment; host).

In: distances to the borders of the masks of a frame. Out: BorderCells, the length of border by class and cell of the
image, and how much of it each pose leaves over. Paint that the map does not hold is left over by every pose; paint that
it holds is left over by the wrong ones.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from semloc_jax.alignment.observed import CELL_COLUMNS
from semloc_jax.perception.border_distance import BorderDistances

NUM_BLOCKS = (8, 6)
"""Columns and rows of the parts of an image whose evidence is taken as independent."""
_ROUND = np.pi / 4.0
"""Length of a border over the steps of its staircase, over all directions."""
_MOST_CHANNELS = 1024


@dataclass(frozen=True)
class BorderCells:
    """Borders by camera, class and cell of the image, k of them.

    Attributes:
        key: `int64[k]`, sorted: camera, channel and cell.
        channel: `int64[k]`.
        block: `int64[k]`, part of the image; see `block_of`.
        length_px: `float[k]`, length of border [px].
    """

    key: np.ndarray
    channel: np.ndarray
    block: np.ndarray
    length_px: np.ndarray

    @classmethod
    def of(
        cls,
        borders: BorderDistances,
        channels: Int[np.ndarray, " c"],
        usable: Bool[np.ndarray, "cam h w"],
        usable_stride: float,
        cell_px: float,
        image_size: tuple[int, int],
    ) -> "BorderCells":
        """Returns the borders of a frame.

        Args:
            borders: Distances to them.
            channels: Those that the map holds, `int[c]`.
            usable: `bool[cam h w]`, pixels that count.
            usable_stride: Pixels of the full mask in one of `usable`.
            cell_px: Size of a cell [px].
            image_size: Width and height of the largest mask [px].
        """
        channels = np.intersect1d(channels, np.arange(borders.signed_px.shape[1]))
        inside = borders.signed_px[:, channels] < 0
        steps = inside[:, :, 1:] != inside[:, :, :-1], inside[:, :, :, 1:] != inside[:, :, :, :-1]
        found = [np.unravel_index(np.flatnonzero(step), step.shape) for step in steps]
        camera, which, row, column = (np.concatenate(parts) for parts in zip(*found, strict=True))
        channel = channels[which]
        v, u = ((place + 1) * borders.stride for place in (row, column))
        at = (
            np.minimum((place / usable_stride).astype(int), size - 1)
            for place, size in zip((v, u), usable.shape[1:], strict=True)
        )
        length_px = usable[(camera, *at)] * (borders.stride * _ROUND)
        cell = (v // cell_px).astype(np.int64) * CELL_COLUMNS + (u // cell_px).astype(np.int64)
        key, first, whose = np.unique(_key(camera, channel, cell), return_index=True, return_inverse=True)
        block = block_of(camera[first], cell[first], cell_px, image_size)
        return cls(key, channel[first], block, np.bincount(whose, length_px, len(key)))

    @classmethod
    def none(cls) -> "BorderCells":
        """Returns no borders."""
        nothing = np.zeros(0, np.int64)
        return cls(nothing, nothing, nothing, np.zeros(0))

    def rows(self, camera: np.ndarray, channel: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """Returns the row of each of some cells, -1 where no border of the class lies in it."""
        if not len(self.key):
            return np.full(len(cell), -1)
        key = _key(camera, channel, cell)
        row = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
        return np.where(self.key[row] == key, row, -1)

    def left_over(self, pose: np.ndarray, row: np.ndarray, length_px: np.ndarray, num_poses: int) -> np.ndarray:
        """Returns the share of every border that has no contour of the map on it, `float[num_poses k]`.

        Args:
            pose: `int[s]`, of pieces of contour that lie on borders.
            row: `int[s]`, row of the border that each lies on; -1 for none.
            length_px: `float[s]`, their lengths.
            num_poses: Number of poses.
        """
        here = np.flatnonzero(row >= 0)
        return 1.0 - self.covered(pose[here] * len(self.key) + row[here], length_px[here], num_poses)

    def covered(self, place: np.ndarray, length_px: np.ndarray, num_poses: int) -> np.ndarray:
        """Returns the share of every border that has contours of the map on it, `float[num_poses k]`.

        Args:
            place: `int[s]`, number of the pose times that of the borders, and row of the border, of pieces of contour.
            length_px: `float[s]`, their lengths.
            num_poses: Number of poses.
        """
        found = np.bincount(place, length_px, num_poses * len(self.key)).reshape(num_poses, len(self.key))
        return np.minimum(found / np.maximum(self.length_px, 1e-9), 1.0)


def block_of(camera: np.ndarray, cell: np.ndarray, cell_px: float, image_size: tuple[int, int]) -> np.ndarray:
    """Returns the part of the image that each cell lies in, counted over all cameras, `int64`."""
    column, row = cell % CELL_COLUMNS, cell // CELL_COLUMNS
    across, down = (
        np.minimum((count * cell_px * axis / max(size, 1)).astype(int), count - 1)
        for count, axis, size in zip(NUM_BLOCKS, (column, row), image_size, strict=True)
    )
    return (camera * NUM_BLOCKS[1] + down) * NUM_BLOCKS[0] + across


def _key(camera: np.ndarray, channel: np.ndarray, cell: np.ndarray) -> np.ndarray:
    return (camera.astype(np.int64) * _MOST_CHANNELS + channel) * CELL_COLUMNS**2 + cell
