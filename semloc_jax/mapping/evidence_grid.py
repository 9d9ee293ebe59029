"""What masks say about the road, from above in a grid that grows where the vehicle drives (room: mapping; host).

In: looks at places of the map: what is seen there and how much the look counts. Out: share of each layer by cell.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

TILE = 512
"""Cells along the side of a tile."""


@dataclass
class EvidenceGrid:
    """Sums over looks: of weights, and for each layer of the weights of those that show it.

    Attributes:
        cell_m: side of a cell [m].
        num_layers: layers of paint and the like.
    """

    cell_m: float
    num_layers: int
    _tiles: dict[tuple[int, int], dict[int, np.ndarray]] = field(default_factory=dict)
    """Planes of each tile that hold anything: most of the road is bare."""

    def add(
        self,
        xy_map: Float[np.ndarray, "n 2"],
        weight: Float[np.ndarray, " n"],
        layer: Int[np.ndarray, " n"],
        usable: Bool[np.ndarray, " n"],
    ) -> None:
        """Adds the looks of one camera of one frame.

        Args:
            xy_map: places [m].
            weight: how much each look counts.
            layer: what is seen, -1 for bare road.
            usable: False where something hides the road.
        """
        xy_map, weight, layer = xy_map[usable], weight[usable], layer[usable]
        if not len(xy_map):
            return
        cell = np.floor(xy_map / self.cell_m).astype(np.int64)
        low = cell.min(axis=0)
        size = cell.max(axis=0) - low + 1
        flat = (cell[:, 1] - low[1]) * size[0] + cell[:, 0] - low[0]
        num_cells = int(size[0] * size[1])
        self._add_window(low, size, 0, np.bincount(flat, weight, num_cells))
        # How often a place was looked at: cells that a look has hit at all.
        self._add_window(low, size, 1, (np.bincount(flat, minlength=num_cells) > 0).astype(np.float64))
        for index in np.unique(layer[layer >= 0]):
            shows = layer == index
            self._add_window(low, size, 2 + int(index), np.bincount(flat[shows], weight[shows], num_cells))

    def _add_window(self, low: np.ndarray, size: np.ndarray, plane: int, values: np.ndarray) -> None:
        window = values.reshape(size[1], size[0])
        first, last = low // TILE, (low + size - 1) // TILE
        for ty in range(int(first[1]), int(last[1]) + 1):
            for tx in range(int(first[0]), int(last[0]) + 1):
                start = np.maximum(low, [tx * TILE, ty * TILE])
                end = np.minimum(low + size, [(tx + 1) * TILE, (ty + 1) * TILE])
                part = window[start[1] - low[1] : end[1] - low[1], start[0] - low[0] : end[0] - low[0]]
                if not part.any():
                    continue
                tile = self._tiles.setdefault((tx, ty), {})
                if plane not in tile:
                    tile[plane] = np.zeros((TILE, TILE), np.float32)
                at = start - [tx * TILE, ty * TILE]
                tile[plane][at[1] : at[1] + part.shape[0], at[0] : at[0] + part.shape[1]] += part

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """First cell and number of cells (x, y) of the box of all tiles."""
        keys = np.array(list(self._tiles) or [(0, 0)])
        low = keys.min(axis=0) * TILE
        return low, (keys.max(axis=0) + 1) * TILE - low

    def plane(self, index: int) -> Float[np.ndarray, "h w"]:
        """One plane over the box of all tiles: 0 the weights, 1 the number of looks, 2 + k the layer k."""
        low, size = self.bounds
        whole = np.zeros((size[1], size[0]), np.float32)
        for (tx, ty), tile in self._tiles.items():
            if index in tile:
                x, y = tx * TILE - low[0], ty * TILE - low[1]
                whole[y : y + TILE, x : x + TILE] = tile[index]
        return whole

    def share(self, layer: int) -> Float[np.ndarray, "h w"]:
        """Share of the weight of all looks that shows a layer, 0 where nobody looked."""
        weight = self.plane(0)
        return np.divide(self.plane(2 + layer), weight, out=np.zeros_like(weight), where=weight > 0)

    def sums(
        self, xy_map: Float[np.ndarray, "n 2"], layer: int
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Weight of all looks at places [m], and of those that show a layer."""
        planes = self._at(xy_map, (0, 2 + layer))
        return planes[0], planes[1]

    def seen(self, xy_map: Float[np.ndarray, "n 2"], num_looks: int) -> Bool[np.ndarray, " n"]:
        """Whether places [m] were looked at in at least so many frames."""
        return self._at(xy_map, (1,))[0] >= num_looks

    def _at(self, xy_map: Float[np.ndarray, "n 2"], planes: tuple[int, ...]) -> np.ndarray:
        cell = np.floor(np.asarray(xy_map) / self.cell_m).astype(np.int64)
        found = np.zeros((len(planes), len(cell)))
        tile_of, at = cell // TILE, cell % TILE
        for key in {tuple(pair) for pair in tile_of.tolist()} & self._tiles.keys():
            here = (tile_of == key).all(axis=1)
            for row, plane in enumerate(planes):
                if plane in self._tiles[key]:
                    found[row, here] = self._tiles[key][plane][at[here, 1], at[here, 0]]
        return found
