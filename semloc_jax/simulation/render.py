"""Inverse ray casting: the class and the colour of every pixel centre (room: simulation; host).

In: a Scene, a camera and its pose. Out: RenderedView. A pixel has the class of what its CENTRE ray hits: borders of
masks carry no bias below the pixel grid.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.cameras import Camera
from semloc_jax.simulation.scene import Scene
from semloc_jax.simulation.solids import Solid

_TILE_PX = 16
RANGE_M = 260.0
COARSE_PX = 8
_FREE_SHARE, _FREE_MARGIN_M = 0.97, 0.3


@dataclass(frozen=True)
class RenderedView:
    """What one camera sees.

    Args:
        class_id: class of each pixel; 0 outside the field of view.
        range_m: distance along the ray, inf where nothing is hit.
        normal_map: unit normal of the surface hit, zero where nothing is.
        color: albedo of solids, blue green red; nan on ground and backdrop, which are coloured by class.
        ray_map: unit rays in the map frame.
        in_view: whether the camera model reaches the pixel.
    """

    class_id: UInt8[np.ndarray, "h w"]
    range_m: Float[np.ndarray, "h w"]
    normal_map: Float[np.ndarray, "h w 3"]
    color: Float[np.ndarray, "h w 3"]
    ray_map: Float[np.ndarray, "h w 3"]
    in_view: Bool[np.ndarray, "h w"]


class PixelRays:
    """Rays of all pixel centres of a camera, computed once, and cones around tiles of them for culling."""

    def __init__(self, camera: Camera):
        """Rays of `camera`."""
        width, height = camera.resolution
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        ray, valid = camera.unproject(np.stack([u, v], axis=-1))
        self.shape = (height, width)
        self.valid = np.asarray(valid)
        self.ray_cam = np.array(ray, dtype=np.float64).reshape(-1, 3)
        self.ray_cam /= np.linalg.norm(self.ray_cam, axis=1, keepdims=True)
        self._tile_pixels = self._tiles()
        self.tile_axis_cam = np.array([self.ray_cam[pixels].mean(axis=0) for pixels in self._tile_pixels])
        self.tile_axis_cam /= np.linalg.norm(self.tile_axis_cam, axis=1, keepdims=True)
        self.tile_angle_rad = np.array(
            [
                np.arccos(np.clip(self.ray_cam[pixels] @ axis, -1.0, 1.0)).max()
                for pixels, axis in zip(self._tile_pixels, self.tile_axis_cam, strict=True)
            ]
        )

    def _tiles(self) -> list[np.ndarray]:
        """Flat indices of the pixels of each tile; tiles without a valid pixel are left out."""
        height, width = self.shape
        index = np.arange(height * width).reshape(height, width)
        tiles = []
        for top in range(0, height, _TILE_PX):
            for left in range(0, width, _TILE_PX):
                rows, columns = slice(top, top + _TILE_PX), slice(left, left + _TILE_PX)
                pixels = index[rows, columns][self.valid[rows, columns]]
                if len(pixels):
                    tiles.append(pixels)
        return tiles

    def toward(self, direction: np.ndarray, angle_rad: float, tile_axis: np.ndarray) -> np.ndarray:
        """Flat indices of pixels in tiles that a cone of `angle_rad` around `direction` may touch."""
        apart = np.arccos(np.clip(tile_axis @ direction, -1.0, 1.0))
        return self.pixels_of(np.flatnonzero(apart <= angle_rad + self.tile_angle_rad))

    def pixels_of(self, tiles: np.ndarray) -> np.ndarray:
        """Flat indices of the pixels of some tiles."""
        return np.concatenate([self._tile_pixels[tile] for tile in tiles]) if len(tiles) else np.zeros(0, dtype=int)


def render(
    scene: Scene,
    rays: PixelRays,
    T_map_cam: Float[np.ndarray, "4 4"],
    ego: Sequence[Solid],
    time_s: float,
) -> RenderedView:
    """What a camera at `T_map_cam` sees of the scene at a time.

    Args:
        scene: the world.
        rays: those of the camera.
        T_map_cam: where it is.
        ego: the own vehicle in the map frame.
        time_s: for the traffic.
    """
    origin = T_map_cam[:3, 3]
    ray = rays.ray_cam @ T_map_cam[:3, :3].T
    solids = (*scene.solids, *scene.traffic(time_s), *ego)
    distance, owner = _nearest_hits(scene, solids, rays, T_map_cam, ray)
    class_id = np.where(rays.valid.ravel(), scene.backdrop, 0).astype(np.uint8)
    normal, color = np.zeros((len(ray), 3)), np.full((len(ray), 3), np.nan)
    ground = np.flatnonzero((owner < 0) & np.isfinite(distance))
    xy = origin[:2] + distance[ground, None] * ray[ground, :2]
    class_id[ground] = scene.ground.class_at(xy)
    normal[ground] = scene.surface.normal(xy)
    order = np.flatnonzero(owner >= 0)
    order = order[np.argsort(owner[order], kind="stable")]
    starts = np.searchsorted(owner[order], np.arange(len(solids) + 1))
    for solid, first, last in zip(solids, starts[:-1], starts[1:], strict=True):
        own = order[first:last]
        class_id[own], color[own] = solid.class_id, solid.color
        normal[own] = solid.normal_at(origin + distance[own, None] * ray[own], ray[own])
    height, width = rays.shape
    return RenderedView(
        class_id=class_id.reshape(height, width),
        range_m=distance.reshape(height, width),
        normal_map=normal.reshape(height, width, 3),
        color=color.reshape(height, width, 3),
        ray_map=ray.reshape(height, width, 3),
        in_view=rays.valid,
    )


def _nearest_hits(
    scene: Scene, solids: Sequence[Solid], rays: PixelRays, T_map_cam: np.ndarray, ray: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distance along each ray [m], inf for the backdrop, and the number of the solid that it hits, -1 for others."""
    origin = T_map_cam[:3, 3]
    distance, owner = np.full(len(ray), np.inf), np.full(len(ray), -1)
    seeing = np.flatnonzero(rays.valid.ravel())
    rows, columns = coarse_pixels(rays)
    coarse = ray[(rows[:, None] * rays.shape[1] + columns).ravel()]
    free_m = free_distance(rays, scene.surface.hit(origin, coarse, RANGE_M))
    distance[seeing] = scene.surface.hit(origin, ray[seeing], RANGE_M, free_m[seeing])
    tile_axis = rays.tile_axis_cam @ T_map_cam[:3, :3].T
    for number, solid in enumerate(solids):
        pixels = _pixels_of(solid, origin, rays, tile_axis)
        t = solid.hit(origin, ray[pixels])
        nearer = t < distance[pixels]
        distance[pixels[nearer]], owner[pixels[nearer]] = t[nearer], number
    return distance, owner


def coarse_pixels(rays: PixelRays) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of a coarse grid of pixels, the last ones included."""
    rows, columns = (np.unique(np.append(np.arange(0, size, COARSE_PX), size - 1)) for size in rays.shape)
    return rows, columns


def free_distance(rays: PixelRays, hit_m: Float[np.ndarray, " k"]) -> Float[np.ndarray, " n"]:
    """How far each ray surely runs above the ground [m]: a little less than the rays of the coarse grid around it.

    Args:
        rays: of all pixels.
        hit_m: distances of the rays of `coarse_pixels`, row by row.
    """
    height, width = rays.shape
    rows, columns = coarse_pixels(rays)
    hit = np.where(rays.valid[rows[:, None], columns], hit_m.reshape(len(rows), len(columns)), 0.0)
    nearest = cv2.erode(np.minimum(hit, RANGE_M).astype(np.float32), np.ones((3, 3), dtype=np.uint8))
    free = np.maximum(_FREE_SHARE * nearest.astype(np.float64) - _FREE_MARGIN_M, 0.0)
    return free[np.arange(height)[:, None] // COARSE_PX, np.arange(width) // COARSE_PX].ravel()


def _pixels_of(solid: Solid, origin: np.ndarray, rays: PixelRays, tile_axis: np.ndarray) -> np.ndarray:
    center, radius = solid.bounds
    away = np.linalg.norm(center - origin)
    if away > RANGE_M + radius:
        return np.zeros(0, dtype=int)
    if away <= radius:
        return np.flatnonzero(rays.valid.ravel())
    return rays.toward((center - origin) / away, float(np.arcsin(radius / away)), tile_axis)
