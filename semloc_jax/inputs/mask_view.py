"""Masks and the cameras that see them (room: inputs; host).

In: class ids of the cameras of a frame. Out: MaskSource: masks, their class table, the rig whose pixels they are.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import cv2
import equinox as eqx
import numpy as np

from semloc_jax.cameras import BevCamera, Rig
from semloc_jax.datasets import Frame
from semloc_jax.perception import ClassTable
from semloc_jax.perception.border_mask import BorderMask
from semloc_jax.perception.finer_masks import finer, times_finer
from semloc_jax.perception.surround import SurroundView

_IGNORED = 255


@dataclass(frozen=True)
class MaskSource:
    """Masks of some cameras.

    Attributes:
        name: for messages and records.
        table: what the ids mean.
        cameras: names, in the order of the masks.
        segment: class ids uint8[h w] of one camera of a frame.
        offset_px: (du, dv) by which a camera's masks are off its images; what is at uv in the image, scaled to the size
            of the mask, is at uv + offset.
        size_px: (width, height) of a camera's masks where they are not of the size of its images.
        knows_borders: whether masks tell parts of a pixel themselves (`BorderMask`): others get more pixels where they
            are small.
    """

    name: str
    table: ClassTable
    cameras: tuple[str, ...]
    segment: Callable[[Frame, str], np.ndarray]
    offset_px: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    size_px: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    knows_borders: bool = False

    def masks(self, frame: Frame) -> list[np.ndarray]:
        """Class ids of every camera; moving objects that the data set knows are set to 255 (ignored).

        Small ones have more pixels than `segment` gives, see `perception.finer_masks`.
        """
        masks = []
        for camera in self.cameras:
            mask = self.segment(frame, camera)
            dynamic = frame.dynamic_mask(camera)
            masks.append(mask if dynamic is None else _without(mask, resized(dynamic, mask)))
        return finer(masks)

    def seen_by(self, rig: Rig) -> Rig:
        """The rig that sees the masks of `masks`, one camera for each of them."""
        return self.camera_rig(rig)

    def camera_rig(self, rig: Rig) -> Rig:
        """The rig whose pixels are those of `masks`, camera by camera."""
        seen = self.segment_rig(rig)
        if self.knows_borders:
            return seen
        return seen.with_pixels(times_finer([camera.resolution[::-1] for camera in seen.cameras]))

    def segment_rig(self, rig: Rig) -> Rig:
        """The rig whose pixels are those of `segment`: of the size of the masks, moved by their offset."""
        cameras = []
        for name, camera in zip(rig.names, rig.cameras, strict=True):
            scaled = camera.resized(*self.size_px[name]) if name in self.size_px else camera
            cameras.append(scaled.shifted(*self.offset_px.get(name, (0.0, 0.0))))
        return eqx.tree_at(lambda r: r.cameras, rig, tuple(cameras))


@dataclass(frozen=True)
class TopViewSource(MaskSource):
    """Masks of all cameras as one mask: a top view of the road, seen by one BevCamera.

    Attributes:
        bev: The top view.
        T_base_bev: Its pose, on the plane of the road.
    """

    bev: BevCamera | None = None
    T_base_bev: np.ndarray | None = None
    _views: dict[bytes, SurroundView] = field(default_factory=dict, repr=False, compare=False)

    def masks(self, frame: Frame) -> list[np.ndarray]:
        """One mask, 255 where no camera shows the road."""
        rig = self.camera_rig(frame.rig.select(self.cameras))
        place = np.asarray(rig.T_base_cam).tobytes()
        if place not in self._views:
            self._views.clear()  # cameras that move in the rig get new tables for every frame
            self._views[place] = SurroundView.of(rig, self.bev, self.T_base_bev)
        return [self._views[place].stitch(super().masks(frame), self.table.unusable_ids)]

    def seen_by(self, rig: Rig) -> Rig:
        """The top view alone."""
        return Rig([self.bev], self.T_base_bev[None], ["top_view"])


def _without(mask: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """The mask with what is hidden ignored; what it knows of its borders stays."""
    ids = np.where(hidden, _IGNORED, np.asarray(mask)).astype(np.uint8)
    return mask.with_ids(ids) if isinstance(mask, BorderMask) else ids


def resized(picture: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The picture in the size of another; what is hidden in any part of a pixel is hidden."""
    if picture.shape[:2] == like.shape[:2]:
        return picture
    size = (like.shape[1], like.shape[0])
    if picture.dtype == bool:
        return cv2.resize(picture.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
