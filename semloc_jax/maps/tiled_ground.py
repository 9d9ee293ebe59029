"""The road surface of a large map, looked at only where it is asked for (room: maps; host).

In: what names the elements around a place. Out: TiledGround, a GroundModel for each cell that was asked for.
"""

from collections import OrderedDict
from collections.abc import Callable, Iterable

import numpy as np

from semloc_jax.maps.elements import MapElement, Place
from semloc_jax.maps.ground import GroundModel, RoadPlane

Within = Callable[[np.ndarray, float], Iterable[MapElement]]
"""Every element that comes within a distance [m] of a place `[2]`, uncut; others may be among them."""

_CELL_M = 40.0
_REACH_M = 110.0
"""Ground points are looked for up to 60 m from a place, which may lie 29 m from the middle of its cell."""
_MOST_CELLS = 64


class TiledGround(GroundModel):
    """The road surface around each queried place; the oldest of 64 cells is forgotten."""

    def __init__(self, within: Within):
        super().__init__(np.zeros((0, 3)))
        self._within = within
        self._cells: OrderedDict[tuple[int, ...], GroundModel] = OrderedDict()

    def plane(
        self,
        center: Place,
        radius_m: float = 4.0,
        near_z_m: float | None = None,
        heading_rad: float | None = None,
    ) -> RoadPlane:
        """Returns the plane of the road around a place; see `GroundModel.plane`."""
        cell = tuple(int(v) for v in np.floor(np.asarray(center, dtype=np.float64)[:2] / _CELL_M))
        if cell not in self._cells:
            middle = (np.array(cell) + 0.5) * _CELL_M
            self._cells[cell] = GroundModel.from_elements(self._within(middle, _REACH_M))
            if len(self._cells) > _MOST_CELLS:
                self._cells.popitem(last=False)
        return self._cells[cell].plane(center, radius_m, near_z_m, heading_rad)

    def heights_near(self, center: np.ndarray, radius_m: float) -> np.ndarray:
        """Returns the heights of the road within a radius; see `GroundModel.heights_near`."""
        return GroundModel.from_elements(self._within(center, radius_m)).heights_near(center, radius_m)
