"""Rasters of ground heights (room: maps; host).

In: an ESRI ASCII grid, or the surface of an Argoverse 2 log. Out: GroundRaster in the frame of the map, whose heights
are numbers that ground can have and unknown (NaN) elsewhere, whatever the file held there.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.storage import FARTHEST_M, npy_array, reading

RASTER_SIGMA_M = 0.05
"""Of a raster whose maker says nothing: about the spread of lidar ground on a road."""
_HIGHEST_M = 1e5
"""No ground is so far above or below any level of the sea. Cells beyond are taken as holes: programs mark holes with
-3.4e38, 1e20 or 9.97e36 and do not always say so in the head; in float32 the largest of these would be infinite."""
_CELL_M = (1e-3, 1e4)
"""Sides of cells; a grid in degrees has smaller ones, and a damaged number is mostly far off."""
_SKEW = 1e-3
_MOST_CELLS = 50_000_000


@dataclass(frozen=True)
class GroundRaster:
    """Heights of the ground on a grid, NaN where unknown.

    Attributes:
        heights: `float32[h w]`, heights of the centres of cells [m].
        scale: cells per metre.
        R: rotation of the map into the grid, `float64[2 2]`.
        t: added in metres before scaling, `float64[2]`: cell = scale (R xy + t), column first.
        sigma_m: standard deviation of the heights.
    """

    heights: np.ndarray
    scale: float
    R: np.ndarray
    t: np.ndarray
    sigma_m: float = RASTER_SIGMA_M

    def height_at(self, xy: np.ndarray) -> np.ndarray:
        """Returns heights at places `[n 2]` of the map frame, bilinear between cells that are known; else NaN."""
        column, row = (self.scale * (np.asarray(xy, dtype=np.float64) @ self.R.T + self.t)).T
        h, w = self.heights.shape
        inside = (column > -0.5) & (column < w - 0.5) & (row > -0.5) & (row < h - 0.5)
        column, row = np.clip(column, 0.0, w - 1.0), np.clip(row, 0.0, h - 1.0)
        c, r = np.minimum(column.astype(int), max(w - 2, 0)), np.minimum(row.astype(int), max(h - 2, 0))
        total, weights = np.zeros(len(column)), np.zeros(len(column))
        for dr in (0, 1):
            for dc in (0, 1):
                share = np.abs(1.0 - dr - (row - r)) * np.abs(1.0 - dc - (column - c))
                value = self.heights[np.minimum(r + dr, h - 1), np.minimum(c + dc, w - 1)].astype(np.float64)
                known = np.isfinite(value)
                total += np.where(known, share * np.where(known, value, 0.0), 0.0)
                weights += np.where(known, share, 0.0)
        return np.where(inside & (weights > 0.25), total / np.maximum(weights, 1e-9), np.nan)


def read_ground_raster(path: str | Path) -> GroundRaster:
    """Returns the ground heights in an ESRI ASCII grid (.asc), or in the `map` folder of an Argoverse 2 log.

    Raises:
        SemlocError: no such file, or not a grid of numbers.
    """
    path = Path(path)
    if path.is_dir():
        found = [*path.glob("*ground_height_surface*.npy"), *path.glob("map/*ground_height_surface*.npy")]
        path = found[0] if found else path
    if not path.is_file():
        raise SemlocError(f"ground heights {path}: no such file; give an .asc grid or the folder of an Argoverse 2 log")
    with reading(f"ground heights {path.name}"):
        return _argoverse2(path) if path.suffix == ".npy" else _ascii_grid(path)


def _raster(heights: np.ndarray, scale: float, R: np.ndarray, t: np.ndarray, where: str) -> GroundRaster:
    """Returns the raster of heights as a file holds them; the one door for the numbers of both formats."""
    if heights.dtype.kind not in "fiu" or heights.ndim != 2 or not 0 < heights.size <= _MOST_CELLS:
        raise SemlocError(
            f"{where}: an array of {heights.dtype} {heights.shape}; expected rows and columns of heights [m]"
        )
    cell_m = 1.0 / scale if scale else 0.0
    is_turned = np.abs(R).max() < 2.0 and np.abs(R @ R.T - np.eye(2)).max() < _SKEW
    if not (_CELL_M[0] <= cell_m <= _CELL_M[1] and is_turned and (np.abs(t) < FARTHEST_M).all()):
        raise SemlocError(
            f"{where}: cells of {cell_m:g} m, placed by {R.tolist()} and {t.tolist()}; expected metres, cells of "
            f"{_CELL_M[0]:g} to {_CELL_M[1]:g} m and a rotation; export it in a grid in metres"
        )
    most = np.float32(_HIGHEST_M)  # a number of Python would overflow as the float16 of a raster
    known = (heights > -most) & (heights < most)
    if not known.any():
        raise SemlocError(f"{where}: none of {heights.size} cells has a height within {_HIGHEST_M:g} m; is it in mm?")
    return GroundRaster(np.where(known, heights, np.nan).astype(np.float32), scale, R, t)


def _argoverse2(path: Path) -> GroundRaster:
    """Returns the raster of a log; its file beside it maps city coordinates to cells."""
    where = f"ground heights {path.name}"
    heights = npy_array(path, where)
    (sim2,) = path.parent.glob("*img_Sim2_city.json")
    members = json.loads(sim2.read_text(encoding="utf-8"))
    R, t = np.array(members["R"], dtype=np.float64).reshape(2, 2), np.array(members["t"], dtype=np.float64).reshape(2)
    return _raster(heights, float(members["s"]), R, t, where)


def _ascii_grid(path: Path) -> GroundRaster:
    """Returns an ESRI ASCII grid: rows from the north, heights of cells."""
    header: dict[str, float] = {}
    with path.open(encoding="ascii") as stream:
        rest = ""
        for line in stream:
            words = line.split()
            if len(words) != 2 or words[0][:1] not in "ncxyNCXY":
                rest = line
                break
            header[words[0].lower()] = float(words[1])
        shape = (int(header["nrows"]), int(header["ncols"]))
        if not (0 < shape[0] * shape[1] <= _MOST_CELLS and header["cellsize"] > 0.0):
            raise ValueError(f"{shape[0]:.3g} rows of {shape[1]:.3g} cells of {header['cellsize']:g} m")
        values = np.array((rest + stream.read()).split(), dtype=np.float64)
    heights = values.reshape(shape)[::-1].copy()
    heights[heights == header.get("nodata_value", -9999.0)] = np.nan
    half = 0.5 * header["cellsize"]
    west = header["xllcenter"] if "xllcenter" in header else header["xllcorner"] + half
    south = header["yllcenter"] if "yllcenter" in header else header["yllcorner"] + half
    place = -np.array([west, south])
    return _raster(heights, 1.0 / header["cellsize"], np.eye(2), place, f"ground heights {path.name}")
