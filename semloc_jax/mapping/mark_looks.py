"""Looks at short marks of paint: where each frame shows the middle of one (room: mapping; host).

In: masks of a frame. Out: MarkLooks: lines of sight in the base frame.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from semloc_jax.mapping.looking import hiding_ids, paint_layers
from semloc_jax.mapping.sightings import RayTable
from semloc_jax.perception import ClassTable
from semloc_jax.structs import ElementClass

_LONGEST_M = 1.5
"""What is longer is rarely seen whole, and its middle is that of what is seen."""
_LEAST_PX = 12
_COARSEST_M = 0.12
"""Of the road in a pixel, along the line of sight."""
_RIM_PX = 3
"""What is hidden so near to a mark may hide a part of it."""


@dataclass(frozen=True)
class MarkLooks:
    """Lines of sight to the middles of short marks.

    Attributes:
        frame: `int64[n]` index of the pose.
        camera_base: `float64[n 3]` place of the camera [m].
        down_base: `float64[n 3]` the way along the line of sight on which it falls by a metre.
    """

    frame: Int[np.ndarray, " n"]
    camera_base: Float[np.ndarray, "n 3"]
    down_base: Float[np.ndarray, "n 3"]

    def where(self, chosen: np.ndarray) -> "MarkLooks":
        """Some of them."""
        return MarkLooks(self.frame[chosen], self.camera_base[chosen], self.down_base[chosen])

    def on_plane(self, height_m: float) -> Float[np.ndarray, "n 3"]:
        """Where they meet the plane at a height above that of the vehicle, in the base frame [m]."""
        return self.camera_base + (self.camera_base[:, 2:] - height_m) * self.down_base

    @classmethod
    def of(cls, masks: Iterable[tuple[int, UInt8[np.ndarray, "_h _w"], RayTable]], table: ClassTable) -> "MarkLooks":
        """What some masks show.

        Args:
            masks: each with the index of its pose and the directions of its pixels.
            table: what their ids mean.
        """
        layers, layer_of_id = paint_layers(table)
        planes = [plane for layer in layers if layer.label == ElementClass.LANE_MARKING for plane in layer.planes]
        is_line, hides = np.isin(layer_of_id, planes), hiding_ids(table)
        parts = [(index, rays.camera_base, _middles(mask, rays, is_line, hides)) for index, mask, rays in masks]
        frame = np.concatenate([np.full(len(down), index) for index, _, down in parts] or [np.zeros(0, int)])
        eyes = [np.tile(camera, (len(down), 1)) for _, camera, down in parts]
        return cls(
            frame,
            np.concatenate(eyes or [np.zeros((0, 3))]),
            np.concatenate([down for *_, down in parts] or [np.zeros((0, 3))]),
        )


def _middles(mask: np.ndarray, rays: RayTable, is_line: np.ndarray, hides: np.ndarray) -> np.ndarray:
    """Ways down along the lines of sight to the middles of the short marks in one mask."""
    _, _, boxes, middles = cv2.connectedComponentsWithStats(is_line[mask].astype(np.uint8), connectivity=8)
    boxes, middles = boxes[1:], middles[1:]
    x, y, width, height = boxes[:, :4].T
    inside = (x > _RIM_PX) & (y > _RIM_PX)
    inside &= (x + width < mask.shape[1] - _RIM_PX) & (y + height < mask.shape[0] - _RIM_PX)
    inside &= boxes[:, cv2.CC_STAT_AREA] >= _LEAST_PX
    found = []
    for (left, top, wide, high), middle in zip(boxes[inside, :4].tolist(), middles[inside], strict=True):
        rim = mask[top - _RIM_PX : top + high + _RIM_PX, left - _RIM_PX : left + wide + _RIM_PX]
        if hides[rim].any():
            continue
        ends = [[left, top + high // 2], [left + wide, top + high // 2], [left + wide // 2, top]]
        at = np.array([middle, *ends, [left + wide // 2, top + high]])
        down = _down(rays.rays_base, at)
        if not np.isfinite(down).all():
            continue
        places = rays.camera_base[2] * down[:, :2]
        # What a pixel is on the road, along the line of sight.
        pixel_m = rays.camera_base[2] * (1.0 + (down[0, :2] ** 2).sum()) * rays.px_rad
        if pixel_m < _COARSEST_M and np.ptp(places, axis=0).max() < _LONGEST_M:
            found.append(down[0])
    return np.reshape(found, (-1, 3))


def _down(rays_base: np.ndarray, uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Ways along lines of sight on which they fall by a metre, by the four pixels around each place."""
    u, v = uv.astype(np.float32).T[:, :, None]
    ray = cv2.remap(rays_base, u, v, cv2.INTER_LINEAR)[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(ray[:, 2:] < -1e-3, ray / -ray[:, 2:], np.nan).astype(np.float64)
