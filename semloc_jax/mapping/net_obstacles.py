"""Obstacles in single frames, from a network's boxes on the cylinder (room: mapping; host).

In: frames with images, an ObstacleNet, masks of what hides the road. Out: the obstacles that each frame shows, as from
masks. The network tells where on the road the middle of a thing is, also where its foot hides that.
"""

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Drive, Frame
from semloc_jax.datasets.base import IMAGE
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.obstacle_sights import Obstacle, ObstacleConfig, ObstacleFrame, ObstacleObserver, once
from semloc_jax.mapping.road_heights import RoadHeights
from semloc_jax.perception.class_table import UNLABELED_ID
from semloc_jax.perception.cylinder_view import CylinderView
from semloc_jax.perception.networks.obstacle_net import KINDS, ObstacleNet, net_view
from semloc_jax.perception.obstacle_classes import OBSTACLES

_BESIDE_PX = 2
"""So far beside a box its camera still shows something, else the box may be cut off."""


class NetObstacleObserver(ObstacleObserver):
    """Finds the obstacles of one frame after the other by their boxes in the images."""

    def __init__(self, drive: Drive, masks: MaskSource, net: ObstacleNet, config: ObstacleConfig | None = None):
        """The drive, masks of what hides the road, the network.

        Raises:
            SemlocError: a camera has no images, or sees no ground.
        """
        missing = [name for name in masks.cameras if not all(frame.has(IMAGE, name) for frame in drive.frames)]
        if missing:
            raise SemlocError(
                f"drive {drive.name}: camera {missing[0]} has no images, which the network looks at; use --front masks"
            )
        super().__init__(drive.rig, masks, config)
        rig = drive.rig.select(masks.cameras)
        poses = np.asarray(rig.T_base_cam, np.float64)
        self.net = net
        self._pictured = [net_view(camera, T) for camera, T in zip(rig.cameras, poses, strict=True)]

    def _require_classes(self) -> None:
        """Masks need not show obstacles: the network does."""

    def at(self, frame: Frame, index: int, Ts_odom_base: Float[np.ndarray, "n 4 4"]) -> ObstacleFrame:
        """The obstacles of a frame; see `ObstacleObserver.at`."""
        heights, T = self._heights(index, Ts_odom_base), Ts_odom_base[index]
        masks = zip(self.views, self.masks.masks(frame), strict=True)
        hidden = [self._hides[view.warp(mask, UNLABELED_ID)] for view, mask in masks]
        found: list[Obstacle] = []
        for name, view in zip(self.masks.cameras, self._pictured, strict=True):
            found += self._sights(view, view.warp(frame.image(name)), heights, T)
        return ObstacleFrame(once(found), self.views, hidden, heights, T, self.config.range_m)

    def _sights(
        self, view: CylinderView, picture: np.ndarray, heights: RoadHeights, T: Float[np.ndarray, "4 4"]
    ) -> list[Obstacle]:
        """The obstacles of one picture whose feet are seen."""
        said, found = self.net(picture), []
        for kind, box, foot, has_foot in zip(said.kind, said.box, said.foot_uv, said.has_foot, strict=True):
            name = KINDS[int(kind)]
            sigma_m = OBSTACLES[name].depth_m[1]
            top_v = float(box[1]) if box[1] > 1.0 else None
            span_rad = float(box[2] - box[0]) / float(view.cylinder.fx)
            standing = self._standing(name, foot, top_v, view, heights) if has_foot else None
            if standing is not None:
                whole = _sides_shown(view, box)
                aside_m = 0.0 if whole else OBSTACLES[name].depth_m[0]
                found.append(self._obstacle(name, standing, (0.0, sigma_m, aside_m), (span_rad, whole), view, T))
        return found


def _sides_shown(view: CylinderView, box: Float[np.ndarray, " 4"]) -> bool:
    """Whether the camera shows what is beside the lower corners of a box."""
    height, width = view.seen.shape
    v = int(np.clip(round(float(box[3])) - 1, 0, height - 1))
    sides = [round(float(box[0])) - _BESIDE_PX, round(float(box[2])) + _BESIDE_PX]
    return all(0 <= u < width and bool(view.seen[v, u]) for u in sides)
