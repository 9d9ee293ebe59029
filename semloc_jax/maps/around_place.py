"""Of a large map: which elements come near a place, and the road surface there (room: maps; host).

In: elements. Out: PlanIndex: boxes of all as one array, shapes only of those that a query has come near; TiledGround, a
GroundModel for each cell that was asked for.
"""

from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence

import numpy as np
import shapely

from semloc_jax.maps.elements import MapElement, Place
from semloc_jax.maps.ground import GroundModel, RoadPlane

_AT_ONCE = 4096


def plan_geometry(element: MapElement) -> shapely.Geometry:
    """Returns the element seen from above."""
    xy = element.points[:, :2]
    if element.closed and len(xy) >= 3:
        return shapely.Polygon(xy)
    return shapely.LineString(xy) if len(xy) >= 2 else shapely.Point(xy[0])


class PlanIndex:
    """Boxes of elements seen from above. Of 100,000 they are made in a tenth of a second and take 3 MB."""

    def __init__(self, elements: Sequence[MapElement]):
        self._elements = elements
        blocks = [_boxes(elements[start : start + _AT_ONCE]) for start in range(0, len(elements), _AT_ONCE)]
        self._low, self._high = (np.concatenate([block[k] for block in blocks]) for k in (0, 1))
        self._plans: dict[int, shapely.Geometry] = {}

    def near(self, center: np.ndarray, radius_m: float) -> np.ndarray:
        """Returns the places in the list of elements that come within `radius_m` of a place `[2]`, `int64[k]`."""
        inside = (self._high >= center[:2] - radius_m) & (self._low <= center[:2] + radius_m)
        rows = np.flatnonzero(inside.all(axis=1))
        plans = np.array([self._plan(row) for row in rows.tolist()], dtype=object)
        return rows[shapely.dwithin(plans, shapely.Point(center[:2]), radius_m)]

    def _plan(self, row: int) -> shapely.Geometry:
        if row not in self._plans:
            self._plans[row] = plan_geometry(self._elements[row])
        return self._plans[row]


def _boxes(elements: Sequence[MapElement]) -> tuple[np.ndarray, np.ndarray]:
    """Returns the lower and the upper corner of each element, `float64[n 2]` each."""
    count = np.array([len(element.points) for element in elements])
    points, first = np.concatenate([element.points for element in elements])[:, :2], np.cumsum(count) - count
    return np.minimum.reduceat(points, first), np.maximum.reduceat(points, first)


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
