"""True boxes of the obstacles that a drive shows, for judging a network that never saw it (room: learning; host).

In: a drive with images and exact masks; instances where it has them. Out: its views on the cylinder with true boxes.
"""

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from semloc_jax.datasets import Drive, Frame
from semloc_jax.datasets.base import IMAGE
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.learning.obstacle_boxes import LEAST_PX, MOST_M
from semloc_jax.learning.obstacle_lesson import ShownObstacles
from semloc_jax.perception.class_table import UNLABELED_ID
from semloc_jax.perception.cylinder_view import CylinderView
from semloc_jax.perception.networks.obstacle_net import net_view
from semloc_jax.perception.obstacle_classes import obstacle_ids

_INSTANCES = ("inst/{camera}/{frame}.png", "depth/{camera}/{frame}_elem.png")
"""Where a drive of the layout has the number of the thing that each pixel shows."""
_FEWEST_PX = 12
"""Fewer pixels of a thing are crumbs at the rim of another."""


class ObstacleDrive:
    """The views of a drive with their obstacles."""

    def __init__(self, drive: Drive, masks: MaskSource):
        """The drive, and exact masks.

        Raises:
            SemlocError: the masks know no obstacles.
        """
        self.drive, self.masks, self.ids = drive, masks, obstacle_ids(masks.table)
        if not self.ids:
            raise SemlocError(
                f"drive {drive.name}: masks {masks.name} know no obstacles; a network for them is judged by drives "
                "whose masks show some"
            )
        rig = drive.rig.select(masks.cameras)
        poses = np.asarray(rig.T_base_cam, np.float64)
        self.views = [net_view(camera, T) for camera, T in zip(rig.cameras, poses, strict=True)]
        cameras = masks.camera_rig(rig).cameras
        self._mask_views = [net_view(camera, T) for camera, T in zip(cameras, poses, strict=True)]

    def at(self, frame: Frame) -> Iterator[ShownObstacles]:
        """What each camera with an image shows."""
        views = zip(self.masks.cameras, self.views, self._mask_views, self.masks.masks(frame), strict=True)
        for name, view, mask_view, mask in views:
            if frame.has(IMAGE, name):
                numbers = self._instances(frame, name, mask)
                yield self._of(mask_view, view.warp(frame.image(name)), mask, numbers)

    def _instances(self, frame: Frame, camera: str, mask: UInt8[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
        """Number of the thing of each pixel: as the drive has it, else by what hangs together."""
        for place in _INSTANCES:
            path = self.drive.path / place.format(camera=camera, frame=frame.id)
            if path.is_file():
                stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
                if stored is not None and stored.shape == mask.shape:
                    return stored.astype(np.int32)
        numbers = np.zeros(mask.shape, np.int32)
        for ids in self.ids.values():
            _, labels = cv2.connectedComponents(np.isin(mask, ids).astype(np.uint8), connectivity=8)
            numbers = np.where(labels > 0, labels + numbers.max(), numbers)
        return numbers

    def _of(
        self, view: CylinderView, picture: np.ndarray, mask: np.ndarray, numbers: Int[np.ndarray, "h w"]
    ) -> ShownObstacles:
        classes, things = view.warp(mask, UNLABELED_ID), view.warp(numbers.astype(np.uint16))
        kinds, boxes = [], []
        for kind, ids in self.ids.items():
            own = np.isin(classes, ids)
            for number in np.unique(things[own]):
                v, u = np.nonzero(own & (things == number))
                if len(v) >= _FEWEST_PX:
                    kinds.append(kind)
                    boxes.append([u.min() - 0.5, v.min() - 0.5, u.max() + 0.5, v.max() + 0.5])
        box = np.array(boxes, np.float64).reshape(-1, 4)
        range_m = _ranges(view, box)
        asked = ((box[:, 2:] - box[:, :2]) >= LEAST_PX).all(axis=1) & (range_m <= MOST_M)
        return ShownObstacles(picture, tuple(kinds), box, range_m, asked)


def _ranges(view: CylinderView, box: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, " n"]:
    """Range of the road at the lower borders [m]; too far where the foot is hidden, infinite above the horizon."""
    tan = (box[:, 3] - float(view.cylinder.cy)) / float(view.cylinder.fx)
    return np.where(tan > 1e-3, float(view.T_base_cylinder[2, 3]) / np.maximum(tan, 1e-3), np.inf)
