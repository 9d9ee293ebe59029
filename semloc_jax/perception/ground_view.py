"""Tables between a camera image and the top view of the road plane (room: perception; host).

In: a camera and its pose above the road. Out: GroundView, which warps images down and masks back.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from semloc_jax.cameras import BevCamera, Camera
from semloc_jax.errors import SemlocError

_NUM_LEVELS = 4
_ROW = 1024
"""Pixels are looked up in rows of this many: OpenCV wants pictures."""


@dataclass(frozen=True)
class GroundView:
    """Where each pixel of the top view lies in the image, and where each pixel of the image lies in the top view."""

    bev: BevCamera
    """The top view; u grows to the right of the vehicle, v backward."""
    image_uv: np.ndarray
    """Image pixel of each top-view pixel, float32[h_bev w_bev 2]; far outside where not visible."""
    visible: np.ndarray
    """Whether the camera sees the top-view pixel, bool[h_bev w_bev]."""
    bev_uv: np.ndarray
    """Top-view pixel of each image pixel, float32[h w 2]; far outside above the horizon and beyond the range."""
    level: np.ndarray
    """Halvings of the image after which one of its pixels is about one top-view pixel, int[h_bev w_bev]."""

    @classmethod
    def of(
        cls, camera: Camera, T_base_cam: np.ndarray, metres_per_px: float = 0.05, range_m: float = 40.0
    ) -> "GroundView":
        """The top view of all road that the camera sees within a range.

        Args:
            camera: any camera.
            T_base_cam: its pose in the base frame, whose plane z = 0 is the road.
            metres_per_px: size of a top-view pixel [m].
            range_m: distance on the road up to which the view reaches [m].

        Raises:
            SemlocError: no pixel of the camera sees the road within the range.
        """
        ground, on_road = _road_points(camera, np.asarray(T_base_cam, np.float64), range_m)
        if not on_road.any():
            raise SemlocError(
                f"ground view: no pixel of the camera meets the road within {range_m:g} m; check T_base_cam "
                "(z of the base frame points up and is 0 on the road)"
            )
        low, high = ground[on_road].min(axis=0) - 1.0, ground[on_road].max(axis=0) + 1.0
        bev = BevCamera.covering(high[0], -low[0], high[1], -low[1], metres_per_px)
        bev_uv = _to_bev(bev, ground)
        bev_uv[~on_road] = -1e4
        image_uv, visible = _image_pixels(bev, camera, T_base_cam)
        image_uv[~visible] = -1e4
        return cls(bev, image_uv, visible, bev_uv.astype(np.float32), _level(image_uv))

    def warp(self, image: np.ndarray) -> np.ndarray:
        """The top view of an image, uint8[h_bev w_bev ...], anti-aliased; 0 where the camera does not see the road."""
        out = np.zeros((self.visible.size, *image.shape[2:]), image.dtype)
        scaled = image
        for level, (at, uv) in enumerate(self._samples):
            part = cv2.remap(scaled, uv, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            out[at] = part.reshape(-1, *image.shape[2:])[: len(at)]
            size = (max(image.shape[1] >> (level + 1), 1), max(image.shape[0] >> (level + 1), 1))
            scaled = cv2.resize(scaled, size, interpolation=cv2.INTER_AREA)
        return out.reshape(*self.visible.shape, *image.shape[2:])

    @cached_property
    def column_m(self) -> np.ndarray:
        """Metres on the road that one pixel spans sideways, 0 where it sees no road within the range; float[h w]."""
        right = np.roll(self.bev_uv, -1, axis=1)
        step = np.linalg.norm(right - self.bev_uv, axis=-1) / float(self.bev.fx)
        known = (self.bev_uv[..., 0] > -1e3) & (right[..., 0] > -1e3)
        known[:, -1] = False
        return np.where(known, step, 0.0)

    @cached_property
    def column_sizes_m(self) -> np.ndarray:
        """All that `column_m` has on the road, in order, float[n]."""
        return np.sort(self.column_m[self.column_m > 0.0])

    @cached_property
    def _samples(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each halving of the image the visible top-view pixels that are taken from it, and where they lie in it.

        Numbers of pixels, int[n], and places float32[rows 1024 2], the last row filled up.
        """
        samples = []
        for level in range(_NUM_LEVELS):
            at = np.flatnonzero(self.visible & (self.level == level))
            uv = np.zeros(((len(at) // _ROW + 1) * _ROW, 2), np.float32)
            uv[: len(at)] = (self.image_uv.reshape(-1, 2)[at] + 0.5) / 2**level - 0.5
            samples.append((at, uv.reshape(-1, _ROW, 2)))
        return samples

    def warp_back(self, top: np.ndarray, interpolation: int = cv2.INTER_LINEAR) -> np.ndarray:
        """A top-view picture as the camera would see it, [h w ...]; 0 off the road."""
        return cv2.remap(top, self.bev_uv, None, interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def _road_points(camera: Camera, T_base_cam: np.ndarray, range_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Point (x, y) [m] of the road that each pixel sees, float64[h w 2], and whether there is one within the range."""
    width, height = camera.resolution
    uv = np.stack(np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)), axis=-1)
    ray, valid = (np.asarray(part) for part in camera.unproject(uv))
    ray = ray.astype(np.float64) @ T_base_cam[:3, :3].T
    down = -ray[..., 2]
    reach = T_base_cam[2, 3] / np.where(down > 1e-4, down, 1e-4)
    ground = T_base_cam[:2, 3] + reach[..., None] * ray[..., :2]
    distance = np.linalg.norm(ground - T_base_cam[:2, 3], axis=-1)
    return ground, valid & (down > 1e-4) & (distance <= range_m)


def _to_bev(bev: BevCamera, ground: np.ndarray) -> np.ndarray:
    scale = float(bev.fx)
    return np.stack([-ground[..., 1] * scale + float(bev.cx), -ground[..., 0] * scale + float(bev.cy)], axis=-1)


def _image_pixels(bev: BevCamera, camera: Camera, T_base_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    width, height = bev.resolution
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    x, y = (float(bev.cy) - v) / float(bev.fy), (float(bev.cx) - u) / float(bev.fx)
    p_base = np.stack([x, y, np.zeros_like(x)], axis=-1)
    p_cam = (p_base - T_base_cam[:3, 3]) @ T_base_cam[:3, :3]
    uv, valid = (np.array(part) for part in camera.project(p_cam))
    visible = valid & np.asarray(camera.in_image(uv[..., 0], uv[..., 1]))
    return uv.astype(np.float32), visible


def _level(image_uv: np.ndarray) -> np.ndarray:
    """Halvings from the shorter side of the footprint: what is sharp in one direction stays sharp."""
    steps = [np.linalg.norm(np.gradient(image_uv, axis=axis), axis=-1) for axis in (0, 1)]
    shorter = np.minimum(*steps)
    return np.clip(np.floor(np.log2(np.maximum(shorter, 1e-3)) + 0.5), 0, _NUM_LEVELS - 1).astype(int)
