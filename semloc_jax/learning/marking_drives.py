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
from semloc_jax.perception.networks.marking_net import METRES_PER_PX, RIM_SHARE
from semloc_jax.perception.surround import SurroundView
from semloc_jax.structs import ElementClass

SIZE_M = 10.0
"""Side of the top views: what the cameras of a car show well."""
_SAME_M = 0.4
"""Mouths nearer to each other are those of one divider."""
_PAINT_M, _OPEN_M = 0.15, 0.35
"""A point is asked for where the masks show paint so near; around others nothing is asked."""
_BAR_M, _ACROSS = 0.25, 0.5
"""A line so near to a mouth that runs across the divider is the bar at the mouth; sine of the angle between them."""


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
        elements = read_map(drive.map_path).elements
        slots = [e for e in elements if e.label == ElementClass.PARKING_SLOT]
        if not slots:
            raise SemlocError(f"drive {drive.name}: its map has no parking slots; expected a garage or a lot")
        mouths, self.inward = _mouths([element.points[:4, :2] for element in slots])
        lines = [_middle(e.points[:, :2]) for e in elements if e.label == ElementClass.SLOT_LINE]
        self.xy_map = on_paint(mouths, self.inward, lines)
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
        inside = ((uv > RIM_SHARE * size) & (uv < size - 1 - RIM_SHARE * size)).all(axis=1)
        u, v = np.where(inside[:, None], np.rint(uv), 0).astype(int).T
        shown = inside & paint[v, u] & ~hidden[v, u]
        unasked = np.zeros(seen.shape, np.uint8)
        near = ~shown & (uv > -20).all(axis=1) & (uv < size + 20).all(axis=1)
        for place in np.rint(uv[near]).astype(int).tolist():
            cv2.circle(unasked, tuple(place), round(_OPEN_M / METRES_PER_PX), 1, -1)
        rim = round(RIM_SHARE * len(seen))
        unasked[:rim], unasked[-rim:], unasked[:, :rim], unasked[:, -rim:] = 1, 1, 1, 1
        yaw = np.arctan2(step[:, 1], step[:, 0])
        return ShownPoints(picture, (uv[shown] + 0.5) * METRES_PER_PX, yaw[shown], unasked > 0)


def _disc(radius_m: float) -> UInt8[np.ndarray, "k k"]:
    side = 2 * round(radius_m / METRES_PER_PX) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))


def _middle(outline: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "2 2"]:
    """Both ends of the middle of a painted line, whose outline or middle is given."""
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0)) if len(outline) > 2 else outline.mean(axis=0)
    direction = np.linalg.svd(outline - outline.mean(axis=0), full_matrices=False)[2][0]
    along = (outline - middle) @ direction
    return middle + np.array([[along.min()], [along.max()]]) * direction


def on_paint(
    mouths: Float[np.ndarray, "n 2"], inward: Float[np.ndarray, "n 2"], lines: list[Float[np.ndarray, "2 2"]]
) -> Float[np.ndarray, "n 2"]:
    """Mouths moved along their dividers to the middle of the bar across them [m].

    A map gives the corner of a slot, the outer edge of the paint; a marking point is where the middles of lines meet.

    Args:
        mouths: as the map has them.
        inward: unit directions into the slots.
        lines: both ends of the middle of each painted line.
    """
    moved = mouths.copy()
    for k, (mouth, step) in enumerate(zip(mouths, inward, strict=True)):
        for start, end in lines:
            way = end - start
            length_m = max(float(np.linalg.norm(way)), 1e-6)
            sine = abs(float(step[0] * way[1] - step[1] * way[0])) / length_m
            near = float(np.clip((mouth - start) @ way / length_m**2, 0.0, 1.0))
            off = start + near * way - mouth
            if sine > _ACROSS and np.linalg.norm(off) < _BAR_M:
                moved[k] = mouth + float(off @ step) * step
                break
    return moved


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
