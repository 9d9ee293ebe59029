"""Heights for elements that came without: from a ground surface, or from the plane of the road (room: maps; host).

In: a map, a raster of ground heights or a map that has them. Out: the map with heights, and how far each may be off.
Sigmas are one standard deviation of the height above the true road [m]; those without a source are our choice.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.ground import GroundModel, RoadPlane
from semloc_jax.maps.ground_raster import GroundRaster

SIGMA = "height_sigma_m"
"""Attribute of an element whose heights came from a ground surface."""
PLANE_SIGMA_M = 0.02
ROAD_CURVATURE_PER_M = 1.0 / 2000.0
"""A road leaves the plane under the vehicle like a curve of some 2,000 m radius: by 3, 23 and 63 cm at 10, 30 and 50 m.
Measured against planes of 15 m radius: 6, 26 and 56 cm on an Argoverse 2 map, 4, 50 and 126 cm in the hills of
curves_elevation.xodr, 0.3, 5 and 16 cm on the motorway e6mini.xodr."""
PLANE_TILT_SIGMA = 0.03
"""Crossfall of 2.5 % and grades of some per cent: in a map without heights what stands is upright to a level road."""
_SLOPE_SIGMA = 0.01
"""The slope of a plane fitted to paint of the road beside."""
_PLANE_RADIUS_M = 15.0
"""The plane under a vehicle is to hold for what the camera sees ahead, so it is fitted to more than the contact."""
_GROUND_CELL_M = 15.0


def with_heights(elements: Sequence[MapElement], surface: GroundRaster | GroundModel) -> tuple[MapElement, ...]:
    """Returns the elements, those without heights lifted onto a ground surface where it is known.

    Lifted elements have the attribute `height_sigma_m`; those where the surface has a hole stay as they are.

    Args:
        elements: of a map; heights that they lack count from the road.
        surface: in the same frame.
    """
    return tuple(element if element.has_height else _on_surface(element, surface) for element in elements)


def lifted(elements: Sequence[MapElement], ground: GroundModel, center: np.ndarray) -> Sequence[MapElement]:
    """Returns the elements, those without heights on the plane of the road at the vehicle, if there is road near it.

    They still say that they have no heights of their own, so `height_sigmas` knows them.

    Args:
        elements: around the vehicle.
        ground: of the map they come from.
        center: place of the vehicle, `[2]` or `[3]` [m].
    """
    try:
        plane = ground.plane(center, _PLANE_RADIUS_M, near_z_m=float(center[2]) if len(center) == 3 else None)
    except SemlocError:
        return elements
    return [e if e.has_height else e.with_points(_raised(e.points, _z(e, plane))) for e in elements]


def height_sigmas(elements: Sequence[MapElement]) -> Float[np.ndarray, "e 3"]:
    """Returns how far the heights of each element may be off, one standard deviation: near the vehicle [m], curvature
    of the road [1/m], tilt against the vertical [rad].

    At a distance d it is hypot(sigma, curvature d^2 / 2): 0 where the map came with heights, the sigma of the surface
    where they were taken from one, and growing where only the plane of the road at the vehicle is known. Where no
    element has a height, that plane itself is not known, and what stands leans against it.

    Args:
        elements: of the local map.
    """
    tilt = 0.0 if any(e.has_height for e in elements) else PLANE_TILT_SIGMA
    of_plane = (PLANE_SIGMA_M, ROAD_CURVATURE_PER_M, tilt)
    rows = [(float(e.attributes.get(SIGMA, 0.0)), 0.0, 0.0) if e.has_height else of_plane for e in elements]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _z(element: MapElement, plane: RoadPlane) -> np.ndarray:
    """Returns the height of the road under an element; an upright thing stands on it as a whole."""
    heights = np.asarray(plane.height_at(element.points[:, :2]))
    return heights if element.is_painted else np.full(len(heights), heights[0])


def _on_surface(element: MapElement, surface: GroundRaster | GroundModel) -> MapElement:
    if isinstance(surface, GroundRaster):
        heights, sigma_m = surface.height_at(element.points[:, :2]), surface.sigma_m
    else:
        heights, sigma_m = _of_model(element.points[:, :2], surface)
    if not np.isfinite(heights).all():
        return element
    if not (element.is_painted or element.is_logical):
        heights = np.full(len(heights), heights[0])
    told = {**element.attributes, SIGMA: round(sigma_m, 4)}
    return replace(element, points=_raised(element.points, heights), has_height=True, attributes=told)


def _raised(points: np.ndarray, heights: np.ndarray) -> np.ndarray:
    return points + np.column_stack([np.zeros((len(heights), 2)), heights])


def _of_model(xy: np.ndarray, model: GroundModel) -> tuple[np.ndarray, float]:
    """Returns heights at `xy` `[n 2]` from planes fitted about every 15 m, and the root mean square of the fits."""
    heights, sigma_m = np.full(len(xy), np.nan), PLANE_SIGMA_M
    cells = np.floor(xy / _GROUND_CELL_M)
    for cell in np.unique(cells, axis=0):
        rows = (cells == cell).all(axis=1)
        try:
            plane = model.plane(xy[rows].mean(axis=0))
        except SemlocError:
            continue
        heights[rows] = plane.height_at(xy[rows])
        sigma_m = max(sigma_m, float(np.hypot(plane.rms_m, _SLOPE_SIGMA * plane.radius_m)))
    return heights, sigma_m
