"""Marking points that a drive really shows, for judging a network that never saw it (room: learning; host).

In: a drive with images, masks, a true map with slots and true poses. Out: its top views and the points in them.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.looking import hiding_ids
from semloc_jax.maps import read_map
from semloc_jax.perception.class_table import UNLABELED_ID
from semloc_jax.perception.networks.marking_net import METRES_PER_PX
from semloc_jax.perception.surround import SurroundView
from semloc_jax.structs import ElementClass

SIZE_M = 10.0
"""Side of the top views: what the cameras of a car show well."""
_SAME_M = 0.4
"""Mouths nearer to each other are those of one divider."""
_PAINT_M, _OPEN_M = 0.15, 0.35
"""A point is asked for where the masks show paint so near; around others nothing is asked."""
_RIM_M = 0.15


class ShownPoints(NamedTuple):
    """One top view and its truth.

    Attributes:
        picture: uint8[n n 3], blue green red, `METRES_PER_PX` a pixel.
        uv_m: float64[k 2], from its upper left corner [m].
        yaw_rad: float64[k], direction into the slot, from u towards v.
        unasked: bool[n n], where a point may or may not be seen.
    """

    picture: UInt8[np.ndarray, "n n 3"]
    uv_m: Float[np.ndarray, "k 2"]
    yaw_rad: Float[np.ndarray, " k"]
    unasked: Bool[np.ndarray, "n n"]


class MarkingDrive:
    """The top views of a drive with their marking points."""

    def __init__(self, drive: Drive, masks: MaskSource):
        """The drive, and exact masks that say what hides the paint.

        Raises:
            SemlocError: no true map with slots, or no true poses.
        """
        self.drive, self.masks = drive, masks
        if drive.truth is None or drive.map_path is None:
            raise SemlocError(
                f"drive {drive.name}: has no truth; a network is judged by drives with map and true poses"
            )
        slots = [e for e in read_map(drive.map_path).elements if e.label == ElementClass.PARKING_SLOT]
        if not slots:
            raise SemlocError(f"drive {drive.name}: its map has no parking slots; expected a garage or a lot")
        self.xy_map, self.inward = _mouths([element.points[:4, :2] for element in slots])
        rig = drive.rig.select(masks.cameras)
        self.view = SurroundView.around(rig, SIZE_M, METRES_PER_PX)
        self._hidden_ids = np.flatnonzero(hiding_ids(masks.table)).tolist()
        channel = masks.table.channel_of(ElementClass.SLOT_LINE)
        self._paint_ids = masks.table.channels[channel].mask_ids

    def at(self, frame: Frame) -> ShownPoints:
        """The top view of a frame and the points that it shows."""
        picture = self.view.stitch([frame.image(name) for name in self.masks.cameras])
        seen = self.view.stitch(self.masks.masks(frame), self._hidden_ids)
        T = self.drive.truth_at(frame)
        base = (self.xy_map - T[:2, 3]) @ T[:2, :2]
        uv = self.view.pixels(base)
        step = self.view.pixels(base + self.inward @ T[:2, :2]) - uv
        paint = cv2.dilate(np.isin(seen, self._paint_ids).astype(np.uint8), _disc(_PAINT_M)) > 0
        hidden = cv2.dilate((seen == UNLABELED_ID).astype(np.uint8), _disc(_PAINT_M)) > 0
        size = np.array(seen.shape[::-1])
        inside = ((uv > _RIM_M / METRES_PER_PX) & (uv < size - 1 - _RIM_M / METRES_PER_PX)).all(axis=1)
        u, v = np.where(inside[:, None], np.rint(uv), 0).astype(int).T
        shown = inside & paint[v, u] & ~hidden[v, u]
        unasked = np.zeros(seen.shape, np.uint8)
        near = ~shown & (uv > -20).all(axis=1) & (uv < size + 20).all(axis=1)
        for place in np.rint(uv[near]).astype(int).tolist():
            cv2.circle(unasked, tuple(place), round(_OPEN_M / METRES_PER_PX), 1, -1)
        yaw = np.arctan2(step[:, 1], step[:, 0])
        return ShownPoints(picture, (uv[shown] + 0.5) * METRES_PER_PX, yaw[shown], unasked > 0)


def _disc(radius_m: float) -> UInt8[np.ndarray, "k k"]:
    side = 2 * round(radius_m / METRES_PER_PX) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))


def _mouths(slots: list[np.ndarray]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Mouths of the dividers of slots [m] and unit directions into them; neighbours share one."""
    places, inward = [], []
    for corners in slots:
        for mouth, back in ((corners[0], corners[3]), (corners[1], corners[2])):
            step = (back - mouth) / np.linalg.norm(back - mouth)
            twin = [k for k, p in enumerate(places) if np.hypot(*(p - mouth)) < _SAME_M and inward[k] @ step > 0.7]
            if twin:
                places[twin[0]] = 0.5 * (places[twin[0]] + mouth)
            else:
                places.append(mouth)
                inward.append(step)
    return np.array(places), np.array(inward)
