"""The contours of map elements that a camera can see as the border of a class (room: maps; host).

In: map elements. Out: Contour lines with what their silhouette depends on, and which paint lies over which.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from semloc_jax.maps.curves import as_ring, both_sides, without_repeats
from semloc_jax.maps.elements import PAINT_CLASSES, MapElement
from semloc_jax.structs import ElementClass, SampleKind

_JOIN_M = 0.05
"""Ends of two lines of one class and width that are nearer than this belong to one painted line."""
_JOIN_WIDTH_RATIO = 1.2
_HALF_BEAM_M = 0.175
"""Half of the height of a W-beam (AASHTO M 180: 312 mm), and 2 cm for the depth of its profile seen from above."""
_CONE_FOOT = 0.08
"""Share of the height of a cone that its square foot plate hides."""


@dataclass(frozen=True)
class Contour:
    """One line on the contour of an element.

    Attributes:
        line: vertices `[k 3]` in the map frame; what is outside of the element lies to the right of its direction.
        kind: how the silhouette depends on the place of the camera.
        offset_m: `offset_m` of the samples at the first and at the last point, linear in between.
        axis: point `[2]` on the bisector of a vertical edge, on the side of the box, for CORNER.
    """

    line: np.ndarray
    kind: SampleKind = SampleKind.FIXED
    offset_m: tuple[float, float] = (0.0, 0.0)
    axis: np.ndarray | None = None


def element_contours(element: MapElement, caps: tuple[bool, bool] = (True, True)) -> list[Contour]:
    """Returns the visible contours of one element, none for logical ones.

    The result is cached with the element: most elements stay in view while the window around the vehicle moves.

    Args:
        element: any element.
        caps: whether a painted line is capped at its start and at its end.
    """
    kept = element.__dict__.setdefault("_contours", {})
    if caps not in kept:
        kept[caps] = _element_contours(element, caps)
    return kept[caps]


def _element_contours(element: MapElement, caps: tuple[bool, bool]) -> list[Contour]:
    if element.is_logical:
        return []
    points = without_repeats(element.points, element.closed)
    label = element.label
    if label == ElementClass.PILLAR and element.closed:
        return _box_corners(points, element.height_m)
    if element.closed:
        return [Contour(as_ring(_counter_clockwise(points)))] if len(points) >= 3 else []
    if len(points) < 2:
        return []
    if label == ElementClass.CONE:
        return _cone(points, element.radius_m, element.radius_top_m)
    if label in (ElementClass.POLE, ElementClass.PILLAR):
        return _two_sides(points, element.radius_m, element.radius_top_m)
    if label == ElementClass.TRAFFIC_LIGHT:
        return _two_sides(points, 0.5 * element.width_m, 0.5 * element.width_m)
    if label == ElementClass.GUARDRAIL and element.height_m > 0:
        return [Contour(points + [0.0, 0.0, dz]) for dz in (-_HALF_BEAM_M, _HALF_BEAM_M)]
    if element.width_m > 0 and label != ElementClass.SIGN:
        return _ribbon(element, points, caps)
    return [Contour(points)]


def painted_polygon(element: MapElement) -> shapely.Polygon:
    """Returns the painted surface of an element seen from above, cached with the element; empty if it has none."""
    kept = element.__dict__
    if "_polygon" not in kept:
        kept["_polygon"] = _painted_polygon(element)
    return kept["_polygon"]


def _painted_polygon(element: MapElement) -> shapely.Polygon:
    points = without_repeats(element.points, element.closed)
    if element.closed:
        return shapely.Polygon(points[:, :2]) if len(points) >= 3 else shapely.Polygon()
    if len(points) < 2 or element.width_m <= 0:
        return shapely.Polygon()
    left, right = _sides(element)
    return shapely.Polygon(np.vstack([right, left[::-1]])[:, :2])


def open_ends(elements: Sequence[MapElement]) -> np.ndarray:
    """Returns for each element whether its painted line ends at its first and at its last point, `bool[n 2]`.

    It does not end where a query cut it, or where another element of its class and width continues it.
    """
    is_end = np.array([element.true_ends for element in elements], dtype=bool).reshape(-1, 2)
    rows = [i for i, e in enumerate(elements) if e.is_painted and not e.closed and len(e.points) > 1]
    if len(rows) < 1:
        return is_end
    ends = np.array([point for i in rows for point in (elements[i].points[0], elements[i].points[-1])])
    places = shapely.points(ends)
    one, other = shapely.STRtree(places).query(places, predicate="dwithin", distance=_JOIN_M)
    for a, b in zip(one, other, strict=True):
        if (
            a != b
            and abs(ends[a, 2] - ends[b, 2]) < _JOIN_M
            and _is_same_paint(elements[rows[a // 2]], elements[rows[b // 2]])
        ):
            is_end[rows[a // 2], a % 2] = False
    return is_end


def touching_paint(elements: Sequence[MapElement]) -> list[tuple[int, int, shapely.Polygon]]:
    """Returns (element, neighbour, polygon of the neighbour) for painted elements of one class that touch."""
    rows = [i for i, element in enumerate(elements) if element.is_painted]
    polygons = np.array([painted_polygon(elements[i]) for i in rows], dtype=object)
    pairs = []
    for label in PAINT_CLASSES:
        chosen = np.array([k for k, i in enumerate(rows) if elements[i].label == label], dtype=np.int64)
        if len(chosen) < 2:
            continue
        shapely.prepare(polygons[chosen])
        one, other = shapely.STRtree(polygons[chosen]).query(
            polygons[chosen], predicate="dwithin", distance=0.5 * _JOIN_M
        )
        pairs += [
            (rows[chosen[a]], rows[chosen[b]], polygons[chosen[b]]) for a, b in zip(one, other, strict=True) if a != b
        ]
    return pairs


def _is_same_paint(one: MapElement, other: MapElement) -> bool:
    small, large = sorted((one.width_m, other.width_m))
    return one.label == other.label and large <= _JOIN_WIDTH_RATIO * small


def _counter_clockwise(points: np.ndarray) -> np.ndarray:
    """Returns the outline counter-clockwise seen from above (upright outlines stay as they are)."""
    x, y = as_ring(points)[:, :2].T
    return points[::-1] if x[:-1] @ y[1:] - x[1:] @ y[:-1] < 0 else points


def _sides(element: MapElement) -> tuple[np.ndarray, np.ndarray]:
    """Returns the left and the right edge of a line, cached with the element."""
    kept = element.__dict__
    if "_sides" not in kept:
        points = without_repeats(element.points, element.closed)
        kept["_sides"] = both_sides(points, 0.5 * element.width_m, _is_loop(points))
    return kept["_sides"]


def _is_loop(points: np.ndarray) -> bool:
    return len(points) > 3 and bool(np.linalg.norm(points[0] - points[-1]) < _JOIN_M)


def _ribbon(element: MapElement, points: np.ndarray, caps: tuple[bool, bool]) -> list[Contour]:
    left, right = _sides(element)
    contours = [Contour(right), Contour(left[::-1])]
    if _is_loop(points):
        return contours
    if caps[0]:
        contours.append(Contour(np.stack([left[0], right[0]])))
    if caps[1]:
        contours.append(Contour(np.stack([right[-1], left[-1]])))
    return contours


def _two_sides(points: np.ndarray, radius_m: float, radius_top_m: float) -> list[Contour]:
    return [Contour(points, SampleKind.ROUND, (sign * radius_m, sign * radius_top_m)) for sign in (1.0, -1.0)]


def _cone(points: np.ndarray, radius_m: float, radius_top_m: float) -> list[Contour]:
    """Returns both silhouettes of a cone above its foot plate."""
    base, top = points[0], points[-1]
    foot = base + _CONE_FOOT * (top - base)
    return _two_sides(np.stack([foot, top]), radius_m + _CONE_FOOT * (radius_top_m - radius_m), radius_top_m)


def _box_corners(points: np.ndarray, height_m: float) -> list[Contour]:
    """Returns the vertical edges of a prism whose foot outline is `points` `[k 3]`.

    A camera sees an edge as outermost if exactly one of its two faces is turned to it: with faces +-g off the bisector
    of the edge, if the line of sight is less than g off the perpendicular of the bisector.
    """
    feet = _counter_clockwise(points)
    reach_m = np.linalg.norm(feet[:, :2] - feet[:, :2].mean(axis=0), axis=1)
    along = np.roll(feet, -1, axis=0)[:, :2] - feet[:, :2]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    bisector = 0.5 * (normal + np.roll(normal, 1, axis=0))
    cos_g = np.linalg.norm(bisector, axis=1)
    before = np.roll(along, 1, axis=0)
    is_convex = before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0] > 0.0
    return [
        Contour(
            np.stack([feet[i], feet[i] + [0.0, 0.0, height_m]]),
            SampleKind.CORNER,
            (reach_m[i] * cos_g[i], reach_m[i] * cos_g[i]),
            feet[i, :2] - reach_m[i] * bisector[i] / cos_g[i],
        )
        for i in np.flatnonzero(is_convex)
    ]
