"""The road surface under a vehicle, from the paint of the map (room: maps; host).

In: map elements. Out: GroundModel, which gives a RoadPlane or a vehicle pose on the road for a place.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from semloc_jax.errors import SemlocError
from semloc_jax.maps.curves import as_ring, resample, without_repeats
from semloc_jax.maps.elements import PAINT_CLASSES, UPRIGHT_CLASSES, MapElement, Place
from semloc_jax.structs import ElementClass

_POINT_SPACING_M = 1.0
_MOST_ON_LINE = 20_000
_AT_ONCE = 64
"""Elements that are sampled together: 64 of the longest stay below what one call may give."""
_MAX_RADIUS_M = 60.0
_MIN_POINTS = 12
_LEVEL_M = 1.5
"""Half of what a parking deck is at least high."""
_MIN_SPREAD_M = 1.1
"""Root of the smaller principal variance below which the points say too little about one slope: that of the two lines
of a narrow lane."""
_SLOPE_SIGMA = 0.03
"""Prior of a slope (3 %): decides only where the points lie on one line."""
_NOISE_M = 0.02
_NUM_ROBUST_STEPS = 6
_ALONG, _ACROSS = 2.5, 0.6
"""Where the direction of the road is known, a fit reaches along and, at first, across by so many radii: far enough
along to hold a dash of either side, no farther across than to the lines beside the lane. Beyond 10 m floors bend."""
_RADIUS_M = 4.0
"""Radius of the fit around one place."""
_WHOLE_M = 10.0
"""Radius of what is called the whole road."""
_BESIDE_M = 1.5
"""How far beside a vehicle the slope is looked at to see how much the road bends: about half a lane."""
_BENDS_PER_M = 1.0 / 500.0
"""Curvature of a road in height: crests and dips of town and country roads have radii of 500 m and more. Ours."""


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


class RoadSpread(NamedTuple):
    """How far the road is from a plane around a vehicle: what its stand may be off the plane under it."""

    height_m: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0


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
        surface = [e for e in elements if e.label in PAINT_CLASSES or e.label in _SURFACE_CLASSES]
        blocks = [surface[k : k + _AT_ONCE] for k in range(0, len(surface), _AT_ONCE)]
        points = [_surface_points(block) for block in blocks]
        if not points:
            points = [_foot_points(e) for e in elements if e.label in UPRIGHT_CLASSES or e.label == ElementClass.PILLAR]
        stacked = np.vstack([np.zeros((0, 3)), *points])
        return cls(stacked[np.isfinite(stacked).all(axis=1)])

    def heights_near(self, center: np.ndarray, radius_m: float) -> np.ndarray:
        """Returns the heights of the ground points within a radius of a place `[2]`, `float64[n]` [m]."""
        return self.points[np.linalg.norm(self.points[:, :2] - center, axis=1) < radius_m, 2]

    def plane(
        self,
        center: Place,
        radius_m: float = _RADIUS_M,
        near_z_m: float | None = None,
        heading_rad: float | None = None,
    ) -> RoadPlane:
        """Returns the plane of the road around a place: a robust fit that looks farther until it has enough points.

        A road is crowned: its other side slopes the other way. Where the heading is known, the fit looks along the road
        and only as far across as it must to see paint on both sides of the vehicle, so that it is the side the vehicle
        is on, between two dashes, too.

        Args:
            center: place in the map frame, `[2]` or more [m].
            radius_m: radius to start with; points beyond half of it count less and less.
            near_z_m: about how high the road is, for maps with decks or bridges; None takes all levels.
            heading_rad: direction of the road; None looks equally far in all directions.

        Raises:
            SemlocError: the map has no ground points within 60 m of the place.
        """
        return _fit_planes([self._neighbours(np.asarray(center, np.float64)[:2], radius_m, near_z_m, heading_rad)])[0]

    def road_pose(
        self, x: float, y: float, yaw: float, radius_m: float = _RADIUS_M, near_z_m: float | None = None
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
        return _on_plane(self.plane(np.array([x, y]), radius_m, near_z_m, yaw), yaw)

    def road_poses(self, xy: Sequence[Place], yaw: float) -> list[np.ndarray | None]:
        """Returns `road_pose` of vehicles at places with one heading, all in one go; None where there is no road."""
        around: list[_Neighbours | None] = []
        for place in xy:
            try:
                around.append(self._neighbours(np.asarray(place, np.float64)[:2], _RADIUS_M, None, yaw))
            except SemlocError:
                around.append(None)
        found = [one for one in around if one is not None]
        planes = iter(_fit_planes(found) if found else [])
        return [None if one is None else _on_plane(next(planes), yaw) for one in around]

    def road_spread(self, x: float, y: float, yaw: float, near_z_m: float | None = None) -> RoadSpread:
        """Returns how far the surface under a vehicle at (x, y) with heading `yaw` differs from the road as a whole.

        Zero on a plane. On a crowned road the slope across differs by as much as the road bends from side to side,
        which is what the few lines of a map leave open of the slope between them; on the crown itself, where the plane
        is that of neither side, by half the bend between both. Where the nearest ground is farther than the whole of a
        fit reaches, the plane is that of another place, and the road has bent on the way. Arguments as `road_pose`.
        """
        center = np.array([x, y])
        try:
            crown = self._own_and_crown(center, yaw, near_z_m)[1]
        except SemlocError:  # beside the place, paint is too far to be looked for: what the way to it bends decides
            crown = RoadSpread()
        return self._bent(center, crown)

    def road_under(
        self, x: float, y: float, yaw: float, near_z_m: float | None = None
    ) -> tuple[np.ndarray, RoadSpread]:
        """Returns `road_pose` and `road_spread` of a place in one go."""
        center = np.array([x, y])
        try:
            own, crown = self._own_and_crown(center, yaw, near_z_m)
        except SemlocError:
            own, crown = self.plane(center, near_z_m=near_z_m, heading_rad=yaw), RoadSpread()
        return _on_plane(own, yaw), self._bent(center, crown)

    def _own_and_crown(self, center: np.ndarray, yaw: float, near_z_m: float | None) -> tuple[RoadPlane, RoadSpread]:
        """Returns the plane of one side of a road and how far it differs from both together."""
        forward, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        around = [self._neighbours(center + d * left, _RADIUS_M, near_z_m, yaw) for d in (0.0, -_BESIDE_M, _BESIDE_M)]
        own, *beside, whole = _fit_planes([*around, self._neighbours(center, _WHOLE_M, near_z_m, None)])
        bend = max(abs((side.slope - own.slope) @ left) for side in beside)
        differs = np.abs([whole.height_m - own.height_m, *((whole.slope - own.slope) @ np.stack([left, forward]).T)])
        return own, RoadSpread(float(differs[0]), max(float(differs[1]), 0.5 * float(bend)), float(differs[2]))

    def _bent(self, center: np.ndarray, crown: RoadSpread) -> RoadSpread:
        """Returns the spread of a place with what a road bends on the way to it from the nearest ground."""
        if self._tree is None:
            return RoadSpread()
        away_m = float(np.sqrt(max(float(self._tree.query(center)[0]) ** 2 - _WHOLE_M**2, 0.0)))
        bent_m, bent_rad = 0.5 * _BENDS_PER_M * away_m**2, _BENDS_PER_M * away_m
        return RoadSpread(*np.hypot(crown, [bent_m, bent_rad, bent_rad]).tolist())

    def _neighbours(
        self, center: np.ndarray, radius_m: float, near_z_m: float | None, heading_rad: float | None
    ) -> "_Neighbours":
        """Returns ground points around a place, enough for both slopes where possible."""
        found, asked_m, reach_m, along_m = np.zeros((0, 3)), 0.0, 1.0, 0.0
        axes = _axes(heading_rad)
        if heading_rad is not None:
            radius_m, along_m = _ACROSS * radius_m, _ALONG * radius_m
        while self._tree is not None:
            reach_m = max(along_m, radius_m)
            if reach_m > asked_m:
                asked_m = reach_m
                around = self.points[self._tree.query_ball_point(center, reach_m)]
                if near_z_m is not None:
                    around = around[np.abs(around[:, 2] - near_z_m) < _LEVEL_M]
                squares = ((around[:, :2] - center) @ axes) ** 2
            found = around[squares @ (1.0 / reach_m**2, 1.0 / radius_m**2) <= 1.0]
            is_enough = len(found) >= _MIN_POINTS and _spread_m(found[:, :2]) >= _MIN_SPREAD_M
            if is_enough or radius_m >= _MAX_RADIUS_M:
                break
            radius_m = min(1.25 * radius_m, _MAX_RADIUS_M)
        if len(found) == 0:
            raise SemlocError(
                f"no ground of the map within {_MAX_RADIUS_M:.0f} m of ({center[0]:.1f}, {center[1]:.1f}); "
                "expected paint, curbs or pole feet there: check the start position and the map"
            )
        return _Neighbours(found, center, radius_m, axes / (reach_m, radius_m))


class _Neighbours(NamedTuple):
    """What the plane of one place is fitted to."""

    points: np.ndarray
    """Ground points, `[n 3]`."""
    center: np.ndarray
    radius_m: float
    """How far the fit had to look across the heading."""
    scaled_axes: np.ndarray
    """Columns along and across, by how far the points reach that way [1 / m]."""


def _on_plane(plane: RoadPlane, yaw: float) -> np.ndarray:
    """Returns `T_map_base` of a vehicle that stands on a plane where it was fitted."""
    c, s = math.cos(yaw), math.sin(yaw)
    rise = plane.slope[0] * c + plane.slope[1] * s
    x, y, z = np.array([c, s, rise]) / math.hypot(1.0, rise)
    up = plane.normal
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 2], pose[:3, 3] = (x, y, z), up, (*plane.center, plane.height_m)
    pose[:3, 1] = up[1] * z - up[2] * y, up[2] * x - up[0] * z, up[0] * y - up[1] * x
    return pose


def _axes(heading_rad: float | None) -> np.ndarray:
    """Columns `[2 2]`: along the heading and across it; any where there is none."""
    if heading_rad is None:
        return np.eye(2)
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([[c, -s], [s, c]])


_SURFACE_CLASSES = frozenset({ElementClass.CURB, ElementClass.PARKING_SLOT})


def _surface_points(elements: Sequence[MapElement]) -> np.ndarray:
    """Returns the first point of each element, then points along them `[n 3]`."""
    lines, found = [], [element.points[:1] for element in elements]
    for element in elements:
        points = without_repeats(element.points, element.closed)
        line = as_ring(points) if element.closed else points
        if element.length_m <= _MOST_ON_LINE * _POINT_SPACING_M:
            lines.append(line)
        else:  # a broken coordinate makes a line around the earth: it may not cost more than a long road
            found.append(resample([line], element.length_m / _MOST_ON_LINE)[0])
    return np.vstack([*found, resample(lines, _POINT_SPACING_M)[0]])


def _foot_points(element: MapElement) -> np.ndarray:
    return element.points if element.closed else element.points[:1]


def _spread_m(xy: np.ndarray) -> float:
    """Returns the root of the smaller principal variance of `xy` `[n 2]`, n > 1."""
    off = xy - np.add.reduce(xy) / len(xy)
    (xx, both), (_, yy) = (off.T @ off / (len(xy) - 1)).tolist()
    return max(0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), both), 0.0) ** 0.5


def _fit_planes(places: Sequence[_Neighbours]) -> list[RoadPlane]:
    """Returns the planes through points by Cauchy-weighted least squares from the median height on.

    All at once: the points of a road are few, and the calls cost more than the numbers.
    """
    counts = np.array([[len(place.points)] for place in places])
    height, near, beyond = np.zeros((3, len(places), counts.max()))
    design = np.zeros((*height.shape, 3))
    design[..., 0] = 1.0
    middle = np.arange(len(places))[:, None], np.hstack([(counts - 1) // 2, counts // 2])

    def medians(values: np.ndarray) -> np.ndarray:
        return 0.5 * np.add.reduce(np.sort(values + beyond)[middle], axis=1, keepdims=True)

    for row, (points, center, _, scaled_axes) in enumerate(places):
        offset, num = points[:, :2] - center, len(points)
        near[row, :num] = np.exp(-2.0 * np.add.reduce((offset @ scaled_axes) ** 2, axis=1))
        design[row, :num, 1:], height[row, :num] = offset, points[:, 2]
        beyond[row, num:] = np.inf
    prior = np.diag([0.0, 1.0, 1.0]) * (_NOISE_M / _SLOPE_SIGMA) ** 2 + 1e-9 * np.eye(3)
    residual, scale = height - medians(height), np.full(counts.shape, np.inf)
    for _ in range(_NUM_ROBUST_STEPS):
        weight = near / (1.0 + (residual / scale) ** 2)
        weighted = design.swapaxes(1, 2) * weight[:, None]
        plane = np.linalg.solve(weighted @ design + prior, weighted @ height[..., None])
        residual = height - (design @ plane)[..., 0]
        scale = np.maximum(2.4 * 1.4826 * medians(np.abs(residual)), _NOISE_M)
    weight = near / (1.0 + (residual / scale) ** 2)
    rms_m = np.sqrt(np.sum(weight * residual**2, axis=1) / np.sum(weight, axis=1))
    return [
        RoadPlane(place.center, float(z), np.array([dx, dy]), float(rms), len(place.points), place.radius_m)
        for place, (z, dx, dy), rms in zip(places, plane[..., 0].tolist(), rms_m, strict=True)
    ]
