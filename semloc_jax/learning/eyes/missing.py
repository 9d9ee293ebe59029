"""Where frame after frame shows paint that the map does not have (room: learning; host).

In: distances that the masks at hand tell, poses. Out: places on the road of which nothing is known, in images.

No map has all paint. What it lacks must not be taught to be bare road; what a mask invents in one frame must.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.cameras import Camera
from semloc_jax.geometry.polyline import nearest
from semloc_jax.learning.eyes.shapes import seen_corners
from semloc_jax.maps.elements import PAINT_CLASSES, MapElement
from semloc_jax.perception.class_table import ClassTable

PLACE_M = 0.2
"""Side of a place."""
_RANGE_M = (2.0, 15.0)
"""Nearer the own body is in view, farther a cell is as small as errors of the pose."""
_LEAST_LOOKS, _LEAST_SHARE = 5, 0.4
"""So many frames, and this share of them, show paint at a place that has some."""
_BESIDE_M = 0.6
"""Nearer than this to paint of the map it is that paint, seen from a pose that is a bit off."""
_CORNERS = PLACE_M * (np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) - 0.5)
_OFFSET, _ROWS = 2**20, 2**21


class GroundLooks:
    """Frames that saw each place of the road, and those that saw paint there."""

    def __init__(self) -> None:
        self._looks: list[np.ndarray] = []
        self._painted: list[np.ndarray] = []

    def look(
        self,
        camera: Camera,
        T_map_base: np.ndarray,
        T_base_cam: np.ndarray,
        mask: np.ndarray,
        signed_px: Float[np.ndarray, "channel h w"],
        stride: int,
        table: ClassTable,
    ) -> None:
        """Count a frame of one camera.

        Args:
            camera: Whose pixels are those of the mask.
            T_map_base: Pose of the vehicle; its x-y plane is the road.
            T_base_cam: Where the camera sits.
            mask: Class ids; what is not usable is not looked at.
            signed_px: Distances that it shows.
            stride: Pixels of the mask in one of these.
            table: Class table of the mask.
        """
        shows = [k for k, channel in enumerate(table.channels) if PAINT_CLASSES & set(channel.classes)]
        if not shows:
            return
        keys = _around(T_map_base @ T_base_cam)
        uv, valid = seen_corners(camera, _quads(keys, T_map_base), T_map_base @ T_base_cam)
        keys, uv = keys[valid], uv[valid]
        # A painted cell has some paint in it, not all of it: its middle and corners are looked at.
        uv = np.round(np.concatenate([uv.mean(axis=1, keepdims=True), uv], axis=1)).astype(int)
        inside = ((uv >= 0) & (uv < mask.shape[::-1])).all(axis=(1, 2))
        keys, (u, v) = keys[inside], np.moveaxis(uv[inside], -1, 0)
        usable = ~np.isin(np.asarray(mask)[v, u], table.unusable_ids).any(axis=1)
        painted = (signed_px[shows].min(axis=0)[v // stride, u // stride] < 0.0).any(axis=1)
        self._looks.append(keys[usable])
        self._painted.append(keys[usable & painted])

    def missing(self, elements: Sequence[MapElement]) -> np.ndarray:
        """Keys of places with paint that none of the elements is."""
        if not self._looks:
            return np.zeros(0, np.int64)
        keys, looks = np.unique(np.concatenate(self._looks), return_counts=True)
        painted, times = np.unique(np.concatenate(self._painted), return_counts=True)
        shown = np.zeros(len(keys))
        shown[np.searchsorted(keys, painted)] = times
        keys = keys[(looks >= _LEAST_LOOKS) & (shown >= _LEAST_SHARE * looks)]
        xy = _centres(keys)
        for element in elements:
            if len(keys) and element.label in PAINT_CLASSES:
                points = np.concatenate([element.points, element.points[:1]]) if element.closed else element.points
                beside = nearest(points[:, :2], xy).distance_m > _BESIDE_M + 0.5 * element.width_m
                keys, xy = keys[beside], xy[beside]
        return keys


def drawn_missing(
    keys: np.ndarray, camera: Camera, T_map_base: Float[np.ndarray, "4 4"], T_base_cam: Float[np.ndarray, "4 4"]
) -> Bool[np.ndarray, "h w"]:
    """Where an image shows the places."""
    drawn = np.zeros(camera.resolution[::-1], np.uint8)
    near = np.isin(keys, _around(T_map_base @ T_base_cam, 3.0 * _RANGE_M[1]))
    if near.any():
        uv, valid = seen_corners(camera, _quads(keys[near], T_map_base), T_map_base @ T_base_cam)
        for quad in uv[valid]:
            cv2.fillPoly(drawn, [np.round(quad).astype(np.int32)], 1)
    return drawn > 0


def _around(T_map_cam: np.ndarray, range_m: float = _RANGE_M[1]) -> np.ndarray:
    """Keys of the places within a range of a camera."""
    steps = np.arange(-int(range_m / PLACE_M), int(range_m / PLACE_M) + 1)
    offset = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    far = np.linalg.norm(offset, axis=1) * PLACE_M
    own = np.round(T_map_cam[:2, 3] / PLACE_M).astype(np.int64)
    cells = own + offset[(far >= _RANGE_M[0]) & (far <= range_m)]
    return (cells[:, 0] + _OFFSET) * _ROWS + cells[:, 1] + _OFFSET


def _centres(keys: np.ndarray) -> np.ndarray:
    return PLACE_M * np.stack([keys // _ROWS - _OFFSET, keys % _ROWS - _OFFSET], axis=1).astype(np.float64)


def _quads(keys: np.ndarray, T_map_base: np.ndarray) -> Float[np.ndarray, "n 4 3"]:
    """Corners of the places in the plane of the road under the vehicle."""
    xy = _centres(keys)[:, None] + _CORNERS
    normal, origin = T_map_base[:3, 2], T_map_base[:3, 3]
    z = origin[2] - (xy - origin[:2]) @ normal[:2] / normal[2]
    return np.concatenate([xy, z[..., None]], axis=-1)
