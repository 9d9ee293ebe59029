"""Where the masks of a frame come from and how they sit on the image (room: localization; host).

In: a Sequence and the name of a mask folder or segmenter. Out: MaskSource: masks, their class table, the rig that sees
them.
"""

import logging
from collections.abc import Callable, Mapping
from collections.abc import Sequence as Frames
from dataclasses import dataclass, field, replace

import cv2
import equinox as eqx
import numpy as np

from semloc_jax.cameras import BevCamera, Rig
from semloc_jax.datasets import Frame, Sequence
from semloc_jax.errors import SemlocError
from semloc_jax.perception import ClassTable, load_class_table
from semloc_jax.perception.classical_paint import ClassicalPaintSegmenter
from semloc_jax.perception.mask_offset import estimate_mask_offset
from semloc_jax.perception.surround import SurroundView, ground_table, top_view

_LOG = logging.getLogger(__name__)
_OFFSET_FRAMES = 12
_IGNORED = 255
CLASSICAL = "classical"
"""Name of the built-in segmenter of road paint for plain images."""
TOP_VIEW = "ipm:"
"""Before the name of masks: all cameras as one top view of the road (inverse perspective mapping)."""


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
    """

    name: str
    table: ClassTable
    cameras: tuple[str, ...]
    segment: Callable[[Frame, str], np.ndarray]
    offset_px: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    size_px: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def masks(self, frame: Frame) -> list[np.ndarray]:
        """Class ids of every camera; moving objects that the data set knows are set to 255 (ignored)."""
        masks = []
        for camera in self.cameras:
            mask = self.segment(frame, camera)
            dynamic = frame.dynamic_mask(camera)
            masks.append(
                mask if dynamic is None else np.where(_resized(dynamic, mask), _IGNORED, mask).astype(np.uint8)
            )
        return masks

    def seen_by(self, rig: Rig) -> Rig:
        """The rig that sees the masks of `masks`, one camera for each of them."""
        return self.camera_rig(rig)

    def camera_rig(self, rig: Rig) -> Rig:
        """The rig whose pixels are those of the masks of each camera: of their size, moved by their offset."""
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


def mask_source(
    name: str,
    sequence: Sequence,
    cameras: Frames[str] | None = None,
    table: str | None = None,
    offset_px: tuple[float, float] | None = None,
) -> MaskSource:
    """Masks by name.

    Args:
        name: A mask folder of the sequence, or `classical` for the built-in segmenter of road paint; `ipm:` before
            either makes one top view of the road of all cameras.
        sequence: The drive.
        cameras: Names; None for all that have such masks.
        table: Class table, a preset or a YAML file; None for that of the sequence.
        offset_px: Offset of the masks against the images; None estimates it from both where there are images.

    Raises:
        SemlocError: there are no such masks, or no class table is known.
    """
    if name.startswith(TOP_VIEW):
        return _top_view(mask_source(name.removeprefix(TOP_VIEW), sequence, cameras, table, offset_px), sequence)
    first = sequence.frames[0]
    names = tuple(cameras or [n for n in sequence.rig.names if name not in first.files or first.has(name, n)])
    sequence.rig.select(names)
    if name == CLASSICAL:
        return _classical(sequence, names)
    if name not in sequence.mask_sources:
        known = ", ".join((*sequence.mask_sources, CLASSICAL))
        raise SemlocError(f"masks '{name}': drive {sequence.name} has no such folder; expected one of {known}")
    if not (table or sequence.table_name):
        raise SemlocError(f"masks '{name}': no class table is known for {sequence.name}; give --class-table")
    source = MaskSource(
        name,
        load_class_table(table or sequence.table_name),
        names,
        lambda frame, camera: frame.mask(name, camera),
        {} if offset_px is None else dict.fromkeys(names, offset_px),
        _sizes(name, sequence, names),
    )
    _check_table(source, sequence)
    return source if offset_px is not None else _with_offsets(source, sequence)


def _classical(sequence: Sequence, names: tuple[str, ...]) -> MaskSource:
    rig = sequence.rig.select(names)
    segmenters = {camera: ClassicalPaintSegmenter(rig.cameras[i], rig.T_base_cam[i]) for i, camera in enumerate(names)}

    def segment(frame: Frame, camera: str) -> np.ndarray:
        return segmenters[camera](frame.image(camera))

    return MaskSource(CLASSICAL, load_class_table("lane_paint"), names, segment)


def _top_view(source: MaskSource, sequence: Sequence) -> TopViewSource:
    """The source as a top view of what its cameras see."""
    rig = sequence.rig.select(source.cameras)
    return TopViewSource(
        TOP_VIEW + source.name,
        ground_table(source.table),
        source.cameras,
        source.segment,
        source.offset_px,
        source.size_px,
        *top_view(rig),
    )


def _sizes(name: str, sequence: Sequence, cameras: Frames[str]) -> dict[str, tuple[int, int]]:
    """Width and height of the masks of each camera whose masks are not as large as its images."""
    sizes = {}
    for camera, model in zip(cameras, sequence.rig.select(cameras).cameras, strict=True):
        height, width = sequence.frames[0].mask(name, camera).shape
        if (width, height) != model.resolution:
            sizes[camera] = (width, height)
    return sizes


def _resized(picture: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The picture in the size of another; what is hidden in any part of a pixel is hidden."""
    if picture.shape[:2] == like.shape[:2]:
        return picture
    size = (like.shape[1], like.shape[0])
    if picture.dtype == bool:
        return cv2.resize(picture.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def _check_table(source: MaskSource, sequence: Sequence) -> None:
    """Refuse a class table that does not fit the masks: it would localize on nonsense.

    Raises:
        SemlocError: the table and the masks do not fit.
    """
    frames = _spread(sequence.frames, 4)
    report = source.table.report(source.segment(frame, camera) for frame in frames for camera in source.cameras)
    if not report.fits:
        raise SemlocError(
            f"masks '{source.name}' do not fit class table {source.table.name}: {report.problems[0]}; "
            "give --class-table, a preset or a YAML file"
        )


def _with_offsets(source: MaskSource, sequence: Sequence) -> MaskSource:
    """The source with the offset of each camera's masks where it is significant; see `estimate_mask_offset`."""
    offsets = {}
    for camera in source.cameras:
        frames = [frame for frame in _spread(sequence.frames, _OFFSET_FRAMES) if frame.has("rgb", camera)]
        if not frames:
            continue
        masks = [source.segment(frame, camera) for frame in frames]
        images = [_resized(frame.image(camera), mask) for frame, mask in zip(frames, masks, strict=True)]
        try:
            offset = estimate_mask_offset(images, masks, source.table)
        except SemlocError as error:
            _LOG.warning("masks '%s' of %s: offset against the images not known: %s", source.name, camera, error)
            continue
        if offset.is_significant:
            offsets[camera] = (offset.du_px, offset.dv_px)
            _LOG.info("masks '%s' of %s sit (%+.2f, %+.2f) px off the images", source.name, camera, *offset[:2])
    return replace(source, offset_px=offsets)


def _spread(frames: Frames[Frame], num: int) -> list[Frame]:
    """At most `num` frames, evenly spread."""
    return [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, num).astype(int))]
