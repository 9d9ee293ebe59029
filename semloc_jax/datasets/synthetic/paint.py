"""What is painted on the ground of a simulated scene, at exact places (room: datasets; host).

In: painted map elements, ground areas. Out: class ids of ground points.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from jaxtyping import Float, UInt8

from semloc_jax.maps import MapElement

_CELL_M = 0.1


@dataclass(frozen=True)
class GroundArea:
    """A stretch of ground of one class, e.g. road or sidewalk."""

    class_id: int
    outline: Float[np.ndarray, "n 2"]


class PaintedGround:
    """Ground classes: areas by a coarse grid, paint by exact point-in-polygon tests.

    The grid only tells which points are near paint at all; whether such a point is painted is decided on the polygons,
    so that borders are exact whatever the cell size.
    """

    def __init__(
        self, elements: Sequence[MapElement], class_ids: Sequence[int], areas: Sequence[GroundArea], rest: int
    ):
        """Painted `elements` with their `class_ids`, later areas over earlier ones, `rest` beyond all areas."""
        self._polygons = np.array([painted_shape(element) for element in elements], dtype=object)
        self._polygon_class = np.array(class_ids, dtype=np.uint8)
        self._tree = shapely.STRtree(self._polygons)
        self._rest = rest
        corners = np.vstack([area.outline for area in areas] + [element.points[:, :2] for element in elements])
        self._low = corners.min(axis=0) - 1.0
        size = np.ceil((corners.max(axis=0) + 1.0 - self._low) / _CELL_M).astype(int)
        self._area = np.full((size[1], size[0]), rest, dtype=np.uint8)
        for area in areas:
            cv2.fillPoly(self._area, [self._cells(area.outline)], int(area.class_id))
        self._near_paint = np.zeros((size[1], size[0]), dtype=np.uint8)
        for polygon in self._polygons:
            cv2.fillPoly(self._near_paint, [self._cells(np.array(polygon.exterior.coords))], 1)
        self._near_paint = cv2.dilate(self._near_paint, np.ones((5, 5), dtype=np.uint8))

    def class_at(self, xy: Float[np.ndarray, "n 2"]) -> UInt8[np.ndarray, " n"]:
        """Class id of ground points in the map frame."""
        column, row = np.floor((xy - self._low) / _CELL_M).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < self._area.shape[1]) & (row < self._area.shape[0])
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        classes = np.where(inside, self._area[row, column], self._rest).astype(np.uint8)
        near = np.flatnonzero(inside & (self._near_paint[row, column] > 0))
        point, polygon = self._tree.query(shapely.points(xy[near]), predicate="intersects")
        classes[near[point]] = self._polygon_class[polygon]
        return classes

    def _cells(self, xy: np.ndarray) -> np.ndarray:
        return np.round((xy - self._low) / _CELL_M - 0.5).astype(np.int32)


def painted_shape(element: MapElement) -> shapely.Polygon:
    """The painted surface seen from above: the outline of an area, the ribbon of a line with square ends."""
    if element.closed:
        return shapely.Polygon(element.points[:, :2])
    line = shapely.LineString(element.points[:, :2])
    return line.buffer(0.5 * element.width_m, cap_style="flat", join_style="mitre")
