"""What masks say about the road, from above in a grid that grows where the vehicle drives (room: mapping; host).

In: looks at places of the map: what is seen there and how much the look counts. Out: share of each layer by cell.
"""

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from semloc_jax.errors import SemlocError
from semloc_jax.storage import npz_arrays, npz_names, reading, write_npz

TILE = 512
"""Cells along the side of a tile."""
_KEPT_PLANES = 64
"""Of 1 MiB each."""


@dataclass
class EvidenceGrid:
    """Sums over looks: of weights, and for each layer of the weights of those that show it.

    Attributes:
        cell_m: side of a cell [m].
    """

    cell_m: float
    _tiles: dict[tuple[int, int], dict[int, np.ndarray]] = field(default_factory=dict)
    """Planes of each tile that hold anything: most of the road is bare."""
    _parts: dict[tuple[int, int], list[Path]] = field(default_factory=dict)
    """Files with earlier sums of each tile: the sums of a drive are those of its parts, which leave memory."""
    _read: OrderedDict[tuple[tuple[int, int], int], np.ndarray | None] = field(default_factory=OrderedDict)
    """Planes read from parts that were asked for last."""

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
        x, y = (np.floor(axis / self.cell_m).astype(np.int64) for axis in xy_map.T)
        low = np.array([x.min(), y.min()])
        size = np.array([x.max(), y.max()]) - low + 1
        flat = (y - low[1]) * size[0] + x - low[0]
        num_cells = int(size[0] * size[1])
        self._add_window(low, size, 0, np.bincount(flat, weight, num_cells))
        # How often a place was looked at: cells that a look has hit at all.
        self._add_window(low, size, 1, (np.bincount(flat, minlength=num_cells) > 0).astype(np.float64))
        for index in np.unique(layer[layer >= 0]):
            shows = layer == index
            self._add_window(low, size, 2 + int(index), np.bincount(flat[shows], weight[shows], num_cells))

    def _add_window(self, low: np.ndarray, size: np.ndarray, plane: int, values: np.ndarray) -> None:
        window = values.reshape(size[1], size[0])
        for tx, ty in _tiles_of(low, size):
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
    def tiles(self) -> Int[np.ndarray, "t 2"]:
        """Column and row of every tile that was looked at, in memory or in parts."""
        return np.array(sorted({*self._tiles, *self._parts}), dtype=np.int64).reshape(-1, 2)

    def store(self, path: Path) -> None:
        """Writes what was gathered since the last part to a file and takes it out of memory; `attach` takes it in."""
        write_npz(
            path, {_name(key, plane): values for key, tile in self._tiles.items() for plane, values in tile.items()}
        )
        self._tiles = {}

    def attach(self, path: Path) -> None:
        """Takes a part in that `store` wrote.

        Raises:
            SemlocError: it is none.
        """
        where = f"part of a map {path}"
        with reading(where):
            places = [tuple(int(number) for number in name.split("_")) for name in npz_names(path, where)]
            keys = {(x, y) for x, y, _ in places}
        for key in keys:
            paths = self._parts.setdefault(key, [])
            if path not in paths:
                paths.append(path)
        self._read.clear()

    def plane(self, index: int, low: Int[np.ndarray, " 2"], size: Int[np.ndarray, " 2"]) -> Float[np.ndarray, "h w"]:
        """A window of one plane: 0 the weights, 1 the number of looks, 2 + k the layer k.

        Args:
            index: which plane.
            low: column and row of its first cell.
            size: numbers of its columns and rows.
        """
        whole = np.zeros((int(size[1]), int(size[0])), np.float32)
        for tx, ty in _tiles_of(low, size):
            tile = self._tile((tx, ty), index)
            if tile is None:
                continue
            start = np.maximum(low, [tx * TILE, ty * TILE])
            end = np.minimum(low + size, [(tx + 1) * TILE, (ty + 1) * TILE])
            (x0, y0), (x1, y1) = start - [tx * TILE, ty * TILE], end - [tx * TILE, ty * TILE]
            whole[start[1] - low[1] : end[1] - low[1], start[0] - low[0] : end[0] - low[0]] = tile[y0:y1, x0:x1]
        return whole

    def share(self, layer: int, low: Int[np.ndarray, " 2"], size: Int[np.ndarray, " 2"]) -> Float[np.ndarray, "h w"]:
        """Share of the weight of all looks that shows a layer, 0 where nobody looked; a window as for `plane`."""
        weight = self.plane(0, low, size)
        return np.divide(self.plane(2 + layer, low, size), weight, out=np.zeros_like(weight), where=weight > 0)

    def _tile(self, key: tuple[int, int], plane: int) -> np.ndarray | None:
        """One plane of a tile with all its parts; None where it holds nothing."""
        paths, live = self._parts.get(key, []), self._tiles.get(key, {}).get(plane)
        if not paths:
            return live
        if (key, plane) not in self._read:
            name, stored = _name(key, plane), None
            for path in paths:
                found = npz_arrays(path, f"part of a map {path}", names=(name,)).get(name)
                if found is not None and (found.shape != (TILE, TILE) or found.dtype != np.float32):
                    raise SemlocError(f"part of a map {path}: {name} is no tile; begin anew with another --out")
                if found is not None:
                    stored = found if stored is None else stored + found
            self._read[key, plane] = stored
            while len(self._read) > _KEPT_PLANES:
                self._read.popitem(last=False)
        self._read.move_to_end((key, plane))
        stored = self._read[key, plane]
        return stored if live is None else live if stored is None else stored + live

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
        for key in sorted({tuple(pair) for pair in tile_of.tolist()}):
            here = (tile_of == key).all(axis=1)
            for row, plane in enumerate(planes):
                tile = self._tile(key, plane)
                if tile is not None:
                    found[row, here] = tile[at[here, 1], at[here, 0]]
        return found


def _name(key: tuple[int, int], plane: int) -> str:
    return f"{key[0]}_{key[1]}_{plane}"


def _tiles_of(low: np.ndarray, size: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yields every tile that a window touches."""
    first, last = np.asarray(low) // TILE, (np.asarray(low) + size - 1) // TILE
    yield from product(range(int(first[0]), int(last[0]) + 1), range(int(first[1]), int(last[1]) + 1))
