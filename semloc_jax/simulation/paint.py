"""What is painted on the ground of a simulated scene, at exact places (room: simulation; host).

In: painted map elements, ground areas. Out: class ids of ground points.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from jaxtyping import Float, UInt8

from semloc_jax.maps import MapElement

_CELL_M = 0.1
_MOST_CELLS = 4e7
_MARGIN = 4
_NOTHING, _SEVERAL = -1, -2
"""Cells near no border, and cells near borders of several shapes."""
_WEAR_CELL_M = 0.03
_WEAR_CELLS = 1024


@dataclass(frozen=True)
class GroundArea:
    """A stretch of ground of one class, e.g. road or sidewalk."""

    class_id: int
    outline: Float[np.ndarray, "n 2"]


class PaintedGround:
    """Ground classes: areas one over the other, and paint over them.

    A grid only tells which points are near a border, and of which shape; those are decided on the polygons, so that
    borders are exact whatever the cell size.
    """

    def __init__(
        self,
        shapes: Sequence[shapely.Geometry],
        class_ids: Sequence[int],
        areas: Sequence[GroundArea],
        rest: int,
        worn: np.ndarray | None = None,
    ):
        """Painted `shapes` with their `class_ids`, later areas over earlier ones, `rest` beyond all of them.

        `worn` is a repeating pattern bool[n n] of places where paint is gone, one cell 3 cm wide.
        """
        area_shapes = [(shapely.Polygon(area.outline), area.class_id) for area in areas]
        area_parts, paint_parts = _parts(area_shapes), _parts(list(zip(shapes, class_ids, strict=True)))
        self._polygons = np.array([polygon for polygon, _ in (*area_parts, *paint_parts)], dtype=object)
        self._class_of = np.array([class_id for _, class_id in (*area_parts, *paint_parts)], dtype=np.uint8)
        self._num_areas, self._rest, self._worn = len(area_parts), rest, worn
        shapely.prepare(self._polygons)
        self._tree = shapely.STRtree(self._polygons)
        bounds = shapely.bounds(self._polygons)
        self._low = bounds[:, :2].min(axis=0) - 1.0
        extent_m = bounds[:, 2:].max(axis=0) + 1.0 - self._low
        self._cell_m = max(_CELL_M, float(np.sqrt(np.prod(extent_m) / _MOST_CELLS)))
        size = np.ceil(extent_m / self._cell_m).astype(int)
        self._area = np.full((size[1], size[0]), rest, dtype=np.uint8)
        self._near = np.full((size[1], size[0]), _NOTHING, dtype=np.int32)
        for index, polygon in enumerate(self._polygons):
            self._draw(index, polygon)

    def _draw(self, index: int, polygon: shapely.Polygon) -> None:
        """Put one polygon on the grids: the inside of an area, and which shape alone is near to each cell."""
        outline = self._cells(np.array(polygon.exterior.coords))
        rings = [outline, *(self._cells(np.array(ring.coords)) for ring in polygon.interiors)]
        if index < self._num_areas:
            cv2.fillPoly(self._area, rings, int(self._class_of[index]))
        corner = np.maximum(outline.min(axis=0) - _MARGIN, 0)
        end = np.minimum(outline.max(axis=0) + _MARGIN + 1, self._near.shape[::-1])
        here = slice(corner[1], end[1]), slice(corner[0], end[0])
        near = np.zeros((end - corner)[::-1], dtype=np.uint8)
        if index < self._num_areas:
            cv2.polylines(near, [ring - corner for ring in rings], True, 1)
        else:
            cv2.fillPoly(near, [ring - corner for ring in rings], 1)
        covered = cv2.dilate(near, np.ones((5, 5), dtype=np.uint8)) > 0
        alone = covered & (self._near[here] == _NOTHING) & (index >= self._num_areas)
        self._near[here] = np.where(covered, np.where(alone, index, _SEVERAL), self._near[here])

    def class_at(self, xy: Float[np.ndarray, "n 2"]) -> UInt8[np.ndarray, " n"]:
        """Class id of ground points in the map frame."""
        column, row = np.floor((xy - self._low) / self._cell_m).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < self._area.shape[1]) & (row < self._area.shape[0])
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        classes = np.where(inside, self._area[row, column], self._rest).astype(np.uint8)
        shape = np.where(inside, self._near[row, column], _NOTHING)
        several = np.flatnonzero(shape == _SEVERAL)
        classes[several] = self._class_of_several(xy[several])
        near = np.flatnonzero(shape >= 0)
        for number, own in _groups(shape[near], near):
            painted = own[self._covers(number, xy[own])]
            classes[painted] = self._class_of[number]
        return classes

    def _class_of_several(self, xy: np.ndarray) -> np.ndarray:
        """Class ids of points near several shapes: that of the uppermost one."""
        top = np.full(len(xy), -1)
        point, polygon = self._tree.query(shapely.points(xy))
        for number, own in _groups(polygon, point):
            # Shapes come in ascending order: the last one that covers a point is the uppermost.
            top[own[self._covers(number, xy[own])]] = number
        return np.where(top >= 0, self._class_of[top], self._rest)

    def _covers(self, number: int, xy: np.ndarray) -> np.ndarray:
        """Whether points are in one of the shapes, and not where its paint is gone."""
        inside = shapely.intersects_xy(self._polygons[number], xy[:, 0], xy[:, 1])
        return inside & ~self._is_worn(xy) if self._worn is not None and number >= self._num_areas else inside

    def _is_worn(self, xy: np.ndarray) -> np.ndarray:
        cell = np.floor(xy / _WEAR_CELL_M).astype(int) % len(self._worn)
        return self._worn[cell[:, 1], cell[:, 0]]

    def _cells(self, xy: np.ndarray) -> np.ndarray:
        return np.round((xy - self._low) / self._cell_m - 0.5).astype(np.int32)


def _groups(key: np.ndarray, value: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """The values of each key, keys ascending."""
    if len(key):
        order = np.argsort(key, kind="stable")
        keys, starts = np.unique(key[order], return_index=True)
        yield from zip(keys.tolist(), np.split(value[order], starts[1:]), strict=True)


def _parts(shapes: Sequence[tuple[shapely.Geometry, int]]) -> list[tuple[shapely.Polygon, int]]:
    """The polygons that shapes are made of, with their classes; outlines that cross themselves are repaired."""
    parts = []
    for shape, class_id in shapes:
        whole = shape if shape.is_valid else shapely.make_valid(shape)
        collected = shapely.get_parts(shapely.get_parts(whole))
        parts += [(part, class_id) for part in collected if part.geom_type == "Polygon" and part.area > 0.0]
    return parts


def painted_shape(element: MapElement) -> shapely.Geometry:
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
