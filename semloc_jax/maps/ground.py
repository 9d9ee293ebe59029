"""The road surface under a vehicle, from the paint of the map (room: maps; host).

In: map elements. Out: GroundModel, which gives a RoadPlane or a vehicle pose on the road for a place.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from semloc_jax.errors import SemlocError
from semloc_jax.maps.curves import as_ring, resample, without_repeats
from semloc_jax.maps.elements import PAINT_CLASSES, UPRIGHT_CLASSES, MapElement, Place
from semloc_jax.structs import ElementClass

_POINT_SPACING_M = 1.0
_MOST_ON_LINE = 20_000
_MAX_RADIUS_M = 60.0
_MIN_POINTS = 12
_LEVEL_M = 1.5
"""Half of what a parking deck is at least high."""
_MIN_SPREAD_M = 0.8
"""Root of the smaller principal variance below which the points say too little about one slope."""
_SLOPE_SIGMA = 0.03
"""Prior of a slope (3 %): decides only where the points lie on one line."""
_NOISE_M = 0.02
_NUM_ROBUST_STEPS = 6


@dataclass(frozen=True)
class RoadPlane:
    """Plane z = height_m + slope . (xy - center) of the road around one place.

    Attributes:
        center: place of the fit in the map frame, `float64[2]` [m].
        height_m: road height there.
        slope: rise per metre towards x and y of the map, `float64[2]`.
        rms_m: robust root mean square of the points about the plane.
        num_points: points that took part.
        radius_m: how far the fit had to look.
    """

    center: np.ndarray
    height_m: float
    slope: np.ndarray
    rms_m: float
    num_points: int
    radius_m: float

    @property
    def normal(self) -> np.ndarray:
        """Unit normal of the plane, upwards, `float64[3]` in the map frame."""
        normal = np.array([-self.slope[0], -self.slope[1], 1.0])
        return normal / np.linalg.norm(normal)

    def height_at(self, xy: Place) -> np.ndarray | np.floating:
        """Returns the height of the plane [m] at `xy` `[... 2]` of the map frame."""
        return self.height_m + (np.asarray(xy) - self.center) @ self.slope


class GroundModel:
    """Points of the road surface with a spatial index."""

    def __init__(self, points: np.ndarray):
        self.points = points
        """Ground points in the map frame, `float64[n 3]` [m]."""
        self._tree = cKDTree(points[:, :2]) if len(points) else None

    @classmethod
    def from_elements(cls, elements: Iterable[MapElement]) -> "GroundModel":
        """Returns the ground under `elements`: paint, curbs and slots; feet of poles and pillars only without those."""
        elements = list(elements)
        elements = [e for e in elements if e.has_height] or elements
        points = [_surface_points(e) for e in elements if e.label in PAINT_CLASSES or e.label in _SURFACE_CLASSES]
        if not points:
            points = [_foot_points(e) for e in elements if e.label in UPRIGHT_CLASSES or e.label == ElementClass.PILLAR]
        stacked = np.vstack([np.zeros((0, 3)), *points])
        return cls(stacked[np.isfinite(stacked).all(axis=1)])

    def plane(self, center: Place, radius_m: float = 4.0, near_z_m: float | None = None) -> RoadPlane:
        """Returns the plane of the road around a place: a robust fit that looks farther until it has enough points.

        Args:
            center: place in the map frame, `[2]` or more [m].
            radius_m: radius to start with; points beyond half of it count less and less.
            near_z_m: about how high the road is, for maps with decks or bridges; None takes all levels.

        Raises:
            SemlocError: the map has no ground points within 60 m of the place.
        """
        center = np.asarray(center, dtype=np.float64)[:2]
        points, radius_m = self._neighbours(center, radius_m, near_z_m)
        return _fit_plane(points, center, radius_m)

    def road_pose(
        self, x: float, y: float, yaw: float, radius_m: float = 4.0, near_z_m: float | None = None
    ) -> np.ndarray:
        """Returns `T_map_base` `[4 4]` of a vehicle that stands on the road at (x, y) with heading `yaw`.

        The origin of base lies on the plane, its z axis is the normal, and the heading of its x axis seen from above is
        `yaw` exactly.

        Args:
            x: position in the map frame [m].
            y: position in the map frame [m].
            yaw: heading in the map frame, counter-clockwise from x [rad].
            radius_m: see `plane`.
            near_z_m: see `plane`.
        """
        plane = self.plane(np.array([x, y]), radius_m, near_z_m)
        direction = np.array([np.cos(yaw), np.sin(yaw)])
        forward = np.append(direction, plane.slope @ direction)
        forward /= np.linalg.norm(forward)
        up = plane.normal
        pose = np.eye(4)
        pose[:3, :3] = np.stack([forward, np.cross(up, forward), up], axis=1)
        pose[:3, 3] = x, y, plane.height_m
        return pose

    def _neighbours(self, center: np.ndarray, radius_m: float, near_z_m: float | None) -> tuple[np.ndarray, float]:
        """Returns the ground points around a place `[n 3]`, and the radius with enough of them for both slopes."""
        found = np.zeros((0, 3))
        while self._tree is not None:
            found = self.points[self._tree.query_ball_point(center, radius_m)]
            if near_z_m is not None:
                found = found[np.abs(found[:, 2] - near_z_m) < _LEVEL_M]
            is_enough = len(found) >= _MIN_POINTS and _spread_m(found[:, :2]) >= _MIN_SPREAD_M
            if is_enough or radius_m >= _MAX_RADIUS_M:
                break
            radius_m = min(1.5 * radius_m, _MAX_RADIUS_M)
        if len(found) == 0:
            raise SemlocError(
                f"no ground of the map within {_MAX_RADIUS_M:.0f} m of ({center[0]:.1f}, {center[1]:.1f}); "
                "expected paint, curbs or pole feet there: check the start position and the map"
            )
        return found, radius_m


_SURFACE_CLASSES = frozenset({ElementClass.CURB, ElementClass.PARKING_SLOT})


def _surface_points(element: MapElement) -> np.ndarray:
    points = without_repeats(element.points, element.closed)
    line = as_ring(points) if element.closed else points
    # A broken coordinate makes a line around the earth: it may not cost more than a long road.
    spacing_m = max(_POINT_SPACING_M, element.length_m / _MOST_ON_LINE)
    return np.vstack([element.points[:1], resample([line], spacing_m)[0]])


def _foot_points(element: MapElement) -> np.ndarray:
    return element.points if element.closed else element.points[:1]


def _spread_m(xy: np.ndarray) -> float:
    """Returns the root of the smaller principal variance of `xy` `[n 2]`."""
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(xy.T))[0], 0.0)))


def _fit_plane(points: np.ndarray, center: np.ndarray, radius_m: float) -> RoadPlane:
    """Returns the plane through `points` `[n 3]` by Cauchy-weighted least squares from the median height on."""
    offset = points[:, :2] - center
    near = np.exp(-0.5 * np.sum((2.0 * offset / radius_m) ** 2, axis=1))
    design = np.column_stack([np.ones(len(points)), offset])
    prior = np.diag([0.0, 1.0, 1.0]) * (_NOISE_M / _SLOPE_SIGMA) ** 2
    plane = np.array([np.median(points[:, 2]), 0.0, 0.0])
    scale = np.inf
    for _ in range(_NUM_ROBUST_STEPS):
        residual = points[:, 2] - design @ plane
        weight = near / (1.0 + (residual / scale) ** 2)
        weighted = design * weight[:, None]
        plane = np.linalg.solve(weighted.T @ design + prior + 1e-9 * np.eye(3), weighted.T @ points[:, 2])
        residual = points[:, 2] - design @ plane
        scale = max(2.4 * 1.4826 * float(np.median(np.abs(residual))), _NOISE_M)
    weight = near / (1.0 + (residual / scale) ** 2)
    rms_m = float(np.sqrt(np.sum(weight * residual**2) / np.sum(weight)))
    return RoadPlane(center, float(plane[0]), plane[1:], rms_m, len(points), radius_m)
