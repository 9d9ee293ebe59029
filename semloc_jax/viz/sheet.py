"""Many pictures as one (room: viz; host).

In: pictures of one width, uint8[h w 3]. Out: one picture.
"""

from collections.abc import Sequence

import numpy as np


def sheet(tiles: Sequence[np.ndarray], columns: int = 2) -> np.ndarray:
    """Pictures of one width side by side and below each other, each in a cell of the height of the tallest.

    Cells that nothing fills are black. One picture stands alone.
    """
    height, columns = max(tile.shape[0] for tile in tiles), min(columns, len(tiles))
    cells = [np.pad(tile, ((0, height - tile.shape[0]), (0, 0), (0, 0))) for tile in tiles]
    cells += [np.zeros_like(cells[0])] * (-len(cells) % columns)
    return np.vstack([np.hstack(cells[k : k + columns]) for k in range(0, len(cells), columns)])
