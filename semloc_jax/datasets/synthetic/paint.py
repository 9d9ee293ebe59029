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
_WEAR_CELL_M = 0.03
_WEAR_CELLS = 1024


@dataclass(frozen=True)
class GroundArea:
    """A stretch of ground of one class, e.g. road or sidewalk."""

    class_id: int
    outline: Float[np.ndarray, "n 2"]


class PaintedGround:
    """Ground classes: areas one over the other, and paint over them.

    A grid only tells which points are near a border; those are decided on the polygons, so that borders are exact
    whatever the cell size.
    """

    def __init__(
        self,
        elements: Sequence[MapElement],
        class_ids: Sequence[int],
        areas: Sequence[GroundArea],
        rest: int,
        worn: np.ndarray | None = None,
    ):
        """Painted `elements` with their `class_ids`, later areas over earlier ones, `rest` beyond all of them.

        `worn` is a repeating pattern bool[n n] of places where paint is gone, one cell 3 cm wide.
        """
        self._polygons = np.array(
            [shapely.Polygon(area.outline) for area in areas] + [painted_shape(element) for element in elements],
            dtype=object,
        )
        self._class_of = np.array([area.class_id for area in areas] + list(class_ids), dtype=np.uint8)
        self._num_areas, self._rest, self._worn = len(areas), rest, worn
        shapely.prepare(self._polygons)
        self._tree = shapely.STRtree(self._polygons)
        bounds = shapely.bounds(self._polygons)
        self._low = bounds[:, :2].min(axis=0) - 1.0
        size = np.ceil((bounds[:, 2:].max(axis=0) + 1.0 - self._low) / _CELL_M).astype(int)
        self._area = np.full((size[1], size[0]), rest, dtype=np.uint8)
        near = np.zeros((size[1], size[0]), dtype=np.uint8)
        for index, polygon in enumerate(self._polygons):
            outline = [self._cells(np.array(polygon.exterior.coords))]
            if index < self._num_areas:
                cv2.fillPoly(self._area, outline, int(self._class_of[index]))
                cv2.polylines(near, outline, True, 1)
            else:
                cv2.fillPoly(near, outline, 1)
        self._near = cv2.dilate(near, np.ones((5, 5), dtype=np.uint8))

    def class_at(self, xy: Float[np.ndarray, "n 2"]) -> UInt8[np.ndarray, " n"]:
        """Class id of ground points in the map frame."""
        column, row = np.floor((xy - self._low) / _CELL_M).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < self._area.shape[1]) & (row < self._area.shape[0])
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        classes = np.where(inside, self._area[row, column], self._rest).astype(np.uint8)
        near = np.flatnonzero(inside & (self._near[row, column] > 0))
        point, polygon = self._tree.query(shapely.points(xy[near]), predicate="intersects")
        if self._worn is not None:
            kept = (polygon < self._num_areas) | ~self._is_worn(xy[near[point]])
            point, polygon = point[kept], polygon[kept]
        top = np.full(len(near), -1)
        np.maximum.at(top, point, polygon)
        classes[near] = np.where(top >= 0, self._class_of[top], self._rest)
        return classes

    def _is_worn(self, xy: np.ndarray) -> np.ndarray:
        cell = np.floor(xy / _WEAR_CELL_M).astype(int) % len(self._worn)
        return self._worn[cell[:, 1], cell[:, 0]]

    def _cells(self, xy: np.ndarray) -> np.ndarray:
        return np.round((xy - self._low) / _CELL_M - 0.5).astype(np.int32)


def painted_shape(element: MapElement) -> shapely.Polygon:
    """The painted surface seen from above: the outline of an area, the ribbon of a line with square ends."""
    if element.closed:
        return shapely.Polygon(element.points[:, :2])
    line = shapely.LineString(element.points[:, :2])
    return line.buffer(0.5 * element.width_m, cap_style="flat", join_style="mitre")


def wear_pattern(share: float, rng: np.random.Generator) -> np.ndarray | None:
    """Ragged patches that cover `share` of the ground, as a repeating pattern bool[n n]; None for a share of zero."""
    if share <= 0.0:
        return None
    noise = np.zeros((_WEAR_CELLS, _WEAR_CELLS), dtype=np.float32)
    for length_cells, weight in ((2.0, 0.4), (20.0, 1.0)):
        layer = rng.normal(size=noise.shape).astype(np.float32)
        layer = cv2.GaussianBlur(layer, (0, 0), length_cells, borderType=cv2.BORDER_REFLECT)
        noise += weight * layer / layer.std()
    return noise > np.quantile(noise, 1.0 - share)
