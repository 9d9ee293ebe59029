"""A large map in cells that are merged apart (room: mapping; host).

In: Sights in the frame of the map. Out: what of them lies in a cell and around it.
A cell is four tiles wide. What it is made of follows from what lies within its halo alone, so a drive changes only the
cells that it passes; the halo holds enough of the road to lay drives onto each other at the border.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from semloc_jax.mapping.crowd.sights import Sights, Things
from semloc_jax.mapping.crowd.stations import STATION_M, runs_of, stations
from semloc_jax.maps import Belief, MapElement
from semloc_jax.maps.versions.state import TILE_M

CELL_M = 4.0 * TILE_M
HALO_M = 0.5 * TILE_M


class Cell(NamedTuple):
    """A square of the map; that of (0, 0) has the origin in its middle."""

    column: int
    row: int

    @property
    def low(self) -> Float[np.ndarray, "2"]:
        """Its corner of least x and y [m]."""
        return CELL_M * (np.array([self.column, self.row]) - 0.5)

    def holds(self, xy: Float[np.ndarray, "n 2"], beyond_m: float = 0.0) -> Bool[np.ndarray, " n"]:
        """Whether points lie in it, or not farther outside than that; of a shared border the lower side is in."""
        off = xy - self.low
        return ((off >= -beyond_m) & (off < CELL_M + beyond_m)).all(axis=1)

    @property
    def name(self) -> str:
        """Its place, short."""
        return f"{self.column},{self.row}"


def cell_of(element: MapElement) -> Cell:
    """The cell of the middle of an element."""
    xy = element.points[:, :2]
    return Cell(*_cells(0.5 * (xy.min(axis=0) + xy.max(axis=0))[None])[0].tolist())


def _cells(xy: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "n 2"]:
    return np.floor(xy / CELL_M + 0.5).astype(np.int64)


def cells_of(sights: Sights) -> set[Cell]:
    """The cells that a drive, or a map, has anything in."""
    lines = [stations(element.points)[:, :2] for element, _ in sights.lines]
    places = np.concatenate([sights.things.centre, sights.way, *lines])
    return {Cell(*cell) for cell in np.unique(_cells(places), axis=0).tolist()}


def clipped(sights: Sights, cell: Cell) -> Sights:
    """What lies in a cell and its halo; of the way what lies between the first and the last place there."""
    inside = cell.holds(sights.things.centre, HALO_M)
    known = zip(sights.things.elements, sights.things.beliefs, strict=True)
    things = Things.of([item for item, kept in zip(known, inside, strict=True) if kept])
    lines = tuple(part for item in sights.lines for part in cut(*item, cell))
    if sights.is_base:
        return replace(sights, things=things, lines=lines)
    rows = np.flatnonzero(cell.holds(sights.way, HALO_M))
    first, last = (max(int(rows[0]) - 1, 0), int(rows[-1]) + 2) if len(rows) else (0, len(sights.way))
    low, high = cell.low - HALO_M, cell.low + CELL_M + HALO_M
    area = shapely.clip_by_rect(sights.area, *low.tolist(), *high.tolist())
    return replace(sights, things=things, lines=lines, way=sights.way[first:last], area=area)


def cut(element: MapElement, belief: Belief, cell: Cell) -> Iterator[tuple[MapElement, Belief]]:
    """The parts of a line in a cell and its halo."""
    for part in _parts(element, cell, HALO_M):
        yield part, belief


def owned(element: MapElement, cell: Cell) -> list[MapElement]:
    """The parts of a line in the cell alone; they meet those of the cells beside it."""
    return _parts(element, cell, 0.5 * STATION_M)


def _parts(element: MapElement, cell: Cell, beyond_m: float) -> list[MapElement]:
    """The parts of a line in a cell, named after it; a line that lies there whole stays as it is."""
    if cell.holds(element.points[:, :2], beyond_m).all() and cell_of(element) == cell:
        return [element]
    points = stations(element.points)
    parts = []
    for k, (a, b) in enumerate(runs_of(cell.holds(points[:, :2], beyond_m))):
        ends = element.true_ends[0] and a == 0, element.true_ends[1] and b == len(points)
        if b - a > 2:
            name = f"{element.id}@{cell.name}" + (f"/{k}" if k else "")
            parts.append(replace(element, id=name, points=points[a:b], true_ends=ends))
    return parts
