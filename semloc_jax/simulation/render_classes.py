"""Inverse ray casting for masks alone: the class of every pixel centre, without distances, normals and colours (room:
simulation; host).

In: a Scene, a camera and its pose. Out: class ids, those of `render`. The ground is found from a coarse grid of rays by
Newton steps; where those do not settle, at crests and near the horizon, it is searched as `render` does.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.simulation.render import RANGE_M, PixelRays, coarse_pixels, free_distance
from semloc_jax.simulation.scene import Scene
from semloc_jax.simulation.solids import Solid
from semloc_jax.simulation.surface import Surface

_TOLERANCE = 1e-7
"""Height above ground over distance at which a ray counts as arrived, as for the ground itself."""
_STEEP = 1.6
"""Where neighbouring coarse rays differ by this factor there may be a crest between them."""
_DOWN = -1e-3
_NUM_STEPS = 3
"""The last one only says which rays have arrived, unless all have before."""


class MaskRenderer:
    """Renders masks of one scene by one camera; what does not change from frame to frame is computed once."""

    def __init__(self, scene: Scene, rays: PixelRays, T_base_cam: Float[np.ndarray, "4 4"]):
        """For a camera at `T_base_cam` of the vehicle whose body `scene.ego` it may see."""
        self._scene, self._rays = scene, rays
        self._standing = _Bounds(scene.solids)
        self._ego_class = self._own_body(T_base_cam)
        self._free = rays.valid.ravel() & (self._ego_class == 0)
        self._backdrop = np.where(rays.valid.ravel(), scene.backdrop, 0).astype(np.uint8)
        self._axes_cam = np.ascontiguousarray(rays.ray_cam.T)
        self._ray = np.empty_like(rays.ray_cam)
        height, width = rays.shape
        self._rows, self._columns = coarse_pixels(rays)
        self._coarse = (self._rows[:, None] * width + self._columns).ravel()
        self._row, self._row_share = _between(self._rows, height)
        self._column, self._column_share = _between(self._columns, width)

    def classes(self, T_map_cam: Float[np.ndarray, "4 4"], time_s: float) -> UInt8[np.ndarray, "h w"]:
        """Class ids that the camera sees at a time."""
        rays, scene, origin = self._rays, self._scene, T_map_cam[:3, 3]
        ray = self._turned(T_map_cam[:3, :3])
        class_id = self._backdrop.copy()
        distance = self._ground(origin, ray)
        tile_axis = rays.tile_axis_cam @ T_map_cam[:3, :3].T
        is_ground = np.isfinite(distance)
        traffic = scene.traffic(time_s)
        for solid, pixels in (
            *self._standing.seen(origin, rays, tile_axis),
            *_Bounds(traffic).seen(origin, rays, tile_axis),
        ):
            t = solid.hit(origin, ray[pixels])
            nearer = t < distance[pixels]
            hit = pixels[nearer]
            distance[hit], class_id[hit], is_ground[hit] = t[nearer], solid.class_id, False
        ground = np.flatnonzero(is_ground & self._free)
        class_id[ground] = scene.ground.class_at(origin[:2] + distance[ground, None] * ray[ground, :2])
        return np.where(self._ego_class > 0, self._ego_class, class_id).reshape(rays.shape)

    def _turned(self, R_map_cam: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "n 3"]:
        """The rays in the map frame, in a buffer of their own: a matrix product of this shape would wake threads that
        cost more than they bring, and fresh memory costs as much as the numbers."""
        one, other = np.empty_like(self._axes_cam[0]), np.empty_like(self._axes_cam[0])
        for axis in range(3):
            np.multiply(self._axes_cam[0], R_map_cam[axis, 0], out=one)
            for k in (1, 2):
                one += np.multiply(self._axes_cam[k], R_map_cam[axis, k], out=other)
            self._ray[:, axis] = one
        return self._ray

    def _own_body(self, T_base_cam: np.ndarray) -> UInt8[np.ndarray, " n"]:
        """Class of the pixels that show the own vehicle, 0 elsewhere: nothing stands between it and its cameras."""
        ray = self._rays.ray_cam @ T_base_cam[:3, :3].T
        class_id, nearest = np.zeros(len(ray), dtype=np.uint8), np.full(len(ray), np.inf)
        for solid in self._scene.ego:
            t = solid.hit(T_base_cam[:3, 3], ray)
            nearer = (t < nearest) & self._rays.valid.ravel()
            nearest[nearer], class_id[nearer] = t[nearer], solid.class_id
        return class_id

    def _ground(self, origin: np.ndarray, ray: np.ndarray) -> Float[np.ndarray, " n"]:
        """Distance along each ray to the ground, inf where there is none."""
        surface = self._scene.surface
        coarse = surface.hit(origin, ray[self._coarse], RANGE_M)
        distance = np.full(len(ray), np.inf)
        guess, fall, is_smooth = self._guess(origin, coarse, ray)
        rows = np.flatnonzero(is_smooth & self._free)
        t, settled = _newton(surface, origin, ray[rows], guess[rows], fall[rows])
        distance[rows[settled]] = t[settled]
        rest = self._free & ~is_smooth
        rest[rows[~settled]] = True
        rest = np.flatnonzero(rest)
        free_m = free_distance(self._rays, coarse)
        distance[rest] = surface.hit(origin, ray[rest], RANGE_M, free_m[rest])
        return distance

    def _guess(
        self, origin: np.ndarray, coarse: np.ndarray, ray: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Bool[np.ndarray, " n"]]:
        """Distances and speeds of approach between those of the coarse rays, and where no crest lies between them."""
        shape = len(self._rows), len(self._columns)
        far, rays = coarse.reshape(shape), ray[self._coarse]
        hit_m = np.where(np.isfinite(coarse), coarse, 0.0)
        normal = self._scene.surface.normal(origin[:2] + hit_m[:, None] * rays[:, :2])
        # How far the camera is above the place it looks at changes slowly from ray to ray, unlike the distance.
        depth_m = self._fine(hit_m * np.maximum(-rays[:, 2], -_DOWN))
        slope = (normal[:, :2] * rays[:, :2]).sum(axis=1) / normal[:, 2]
        corners = np.stack([far[:-1, :-1], far[1:, :-1], far[:-1, 1:], far[1:, 1:]])
        usable = np.isfinite(corners).all(axis=0) & self._valid_corners()
        smooth = usable & (corners.max(axis=0) < _STEEP * corners.min(axis=0))
        is_smooth = smooth[self._row[:, None], self._column].ravel() & (ray[:, 2] < _DOWN)
        guess = np.divide(depth_m, -ray[:, 2], out=np.zeros(len(ray)), where=is_smooth)
        return guess, np.minimum(ray[:, 2] + self._fine(slope), _DOWN), is_smooth

    def _fine(self, coarse: np.ndarray) -> Float[np.ndarray, " n"]:
        """Values of all pixels from those of the coarse ones."""
        grid = coarse.reshape(len(self._rows), len(self._columns))
        by_row = grid[self._row] + self._row_share[:, None] * (grid[self._row + 1] - grid[self._row])
        first, last = by_row[:, self._column], by_row[:, self._column + 1]
        return (first + self._column_share * (last - first)).ravel()

    def _valid_corners(self) -> np.ndarray:
        valid = self._rays.valid[self._rows[:, None], self._columns]
        return valid[:-1, :-1] & valid[1:, :-1] & valid[:-1, 1:] & valid[1:, 1:]


class _Bounds:
    """Spheres around solids, as arrays."""

    def __init__(self, solids: Sequence[Solid]):
        self._solids = solids
        bounds = [solid.bounds for solid in solids]
        self._center = np.array([center for center, _ in bounds]).reshape(-1, 3)
        self._radius_m = np.array([radius for _, radius in bounds])

    def seen(self, origin: np.ndarray, rays: PixelRays, tile_axis: np.ndarray) -> list[tuple[Solid, np.ndarray]]:
        """The solids that may be in view, each with the pixels that may show it."""
        toward = self._center - origin
        away = np.linalg.norm(toward, axis=1)
        near = np.flatnonzero(away < RANGE_M + self._radius_m)
        share = np.clip(self._radius_m[near] / np.maximum(away[near], 1e-9), 0.0, 1.0)
        cos_apart = tile_axis @ (toward[near] / np.maximum(away[near, None], 1e-9)).T
        # cos(a + b) of the half angles of a tile and a sphere; a sphere around the camera is everywhere.
        cos_tile, sin_tile = np.cos(rays.tile_angle_rad)[:, None], np.sin(rays.tile_angle_rad)[:, None]
        cos_reach = cos_tile * np.sqrt(1.0 - share**2) - sin_tile * share
        touched = (cos_apart >= cos_reach - 1e-9) | (share >= 1.0)
        return [
            (self._solids[index], rays.pixels_of(np.flatnonzero(touched[:, k])))
            for k, index in enumerate(near.tolist())
            if touched[:, k].any()
        ]


def _newton(
    surface: Surface, origin: np.ndarray, ray: np.ndarray, guess: np.ndarray, fall: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distances to the ground from a guess and speeds of approach that are nearly right, and which are exact."""
    t, (dx, dy, dz) = guess, ray.T
    for _ in range(_NUM_STEPS):
        above = origin[2] + t * dz - surface.height(origin[0] + t * dx, origin[1] + t * dy)
        settled = np.abs(above) <= _TOLERANCE * np.maximum(t, 1.0)
        if settled.all():
            break
        t = t - above / fall
    return t, settled & (t > 0.0) & (t < RANGE_M)


def _between(places: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """For each of `count` pixels the coarse place before it, and its share of the way to the next one."""
    pixel = np.arange(count)
    before = np.clip(np.searchsorted(places, pixel, side="right") - 1, 0, max(len(places) - 2, 0))
    return before, (pixel - places[before]) / np.maximum(places[before + 1] - places[before], 1)
