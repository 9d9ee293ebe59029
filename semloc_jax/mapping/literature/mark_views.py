"""What the cameras of a frame show of marks, in a top view that follows the pitch of the vehicle (room: mapping; host).

In: frames, masks or images. Out: FrameMarks: pieces of paint in `base`, the pitch.
Road-SLAM's front end: adaptive inverse perspective mapping, binarisation, connected components. Masks are binarised by
their paint classes; where the masks are `classical`, the images themselves by a top-hat and an adaptive threshold.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.datasets import Drive, Frame
from semloc_jax.inputs.mask_files import CLASSICAL
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.looking import hiding_ids, paint_layers
from semloc_jax.perception import GroundView
from semloc_jax.perception.road_marks import CELL_M, MarkConfig, RoadMark, binarised, marks_of
from semloc_jax.perception.road_pitch import LaneLine, levelled_points, road_pitch

_RANGE_M = 10.0
"""Reach of the top view from a camera: beyond, a row of pixels is some cells long; ours."""
_LINE_SHAPE = 6.0
"""A piece so many times longer than wide, along the way, is a lane line; ours."""
_LINE_LENGTH_M, _LINE_TURN_RAD = 2.0, np.deg2rad(20.0)


@dataclass(frozen=True)
class FrameMarks:
    """The pieces of paint that one frame shows, in its base frame."""

    marks: list[RoadMark]
    pitch_rad: float


class MarkViews:
    """Looks at the marks of a drive; the tables of the cameras are made once."""

    def __init__(self, drive: Drive, masks: MaskSource, config: MarkConfig | None = None):
        """Nothing is looked at before it is asked for.

        Raises:
            SemlocError: the masks show no paint, or a camera shows no road.
        """
        self.masks, self.config = masks, config or MarkConfig()
        rig = masks.seen_by(drive.rig.select(masks.cameras))
        poses = np.asarray(rig.T_base_cam, np.float64)
        self._views = [GroundView.of(c, T, CELL_M, _RANGE_M) for c, T in zip(rig.cameras, poses, strict=True)]
        self._xy = [_places(view) for view in self._views]
        self._cameras_base = poses[:, :3, 3]
        _, layer_of_id = paint_layers(masks.table)
        self._is_paint = layer_of_id >= 0
        self._is_hidden = hiding_ids(masks.table)

    def of(self, frame: Frame) -> FrameMarks:
        """The marks of a frame, the small pieces left out."""
        found = [self._pieces(frame, k, mask) for k, mask in enumerate(self.masks.masks(frame))]
        lines = [
            LaneLine(_along(mark), self._cameras_base[k])
            for k, marks in enumerate(found)
            for mark in marks
            if _is_line(mark)
        ]
        pitch_rad = road_pitch(lines)
        marks = []
        for camera_base, pieces in zip(self._cameras_base, found, strict=True):
            for mark in pieces:
                xy = levelled_points(mark.xy, camera_base, pitch_rad)
                marks.append(replace(mark, xy=xy[np.isfinite(xy).all(axis=1)]))
        return FrameMarks(marks, pitch_rad)

    def _pieces(self, frame: Frame, camera: int, mask: np.ndarray) -> list[RoadMark]:
        view, xy = self._views[camera], self._xy[camera]
        near = np.linalg.norm(xy - self._cameras_base[camera, :2], axis=-1) <= _RANGE_M
        hidden = self._top(view, self._is_hidden[mask])
        if self.masks.name == CLASSICAL:
            grey = cv2.cvtColor(frame.image(self.masks.cameras[camera]), cv2.COLOR_RGB2GRAY)
            paint = binarised(view.warp(grey))
        else:
            paint = self._top(view, self._is_paint[mask])
        return marks_of(paint, view.visible & near & ~hidden, xy, self.config)

    @staticmethod
    def _top(view: GroundView, shown: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "hb wb"]:
        return view.warp(255 * shown.astype(np.uint8)) > 127


def _places(view: GroundView) -> Float[np.ndarray, "h w 2"]:
    height, width = view.visible.shape
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x, y = (float(view.bev.cy) - v) / float(view.bev.fy), (float(view.bev.cx) - u) / float(view.bev.fx)
    return np.stack([x, y], axis=-1)


def _is_line(mark: RoadMark) -> bool:
    length_m, width_m = mark.size_m
    return bool(length_m >= max(_LINE_LENGTH_M, _LINE_SHAPE * width_m) and mark.turn_rad <= _LINE_TURN_RAD)


def _along(mark: RoadMark) -> Float[np.ndarray, "k 2"]:
    """The middle of a line on every metre of it."""
    metre = np.floor(mark.xy[:, 0]).astype(int)
    return np.array([mark.xy[metre == k].mean(axis=0) for k in np.unique(metre)])
