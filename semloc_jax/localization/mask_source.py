"""Where the masks of a frame come from and how they sit on the image (room: localization; host).

In: a Sequence and the name of a mask folder or segmenter. Out: MaskSource: masks, their class table, the rig that sees
them.
"""

import logging
from collections.abc import Callable, Mapping
from collections.abc import Sequence as Frames
from dataclasses import dataclass, field

import equinox as eqx
import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.datasets import Frame, Sequence
from semloc_jax.errors import SemlocError
from semloc_jax.perception import ClassTable, load_class_table
from semloc_jax.perception.classical_paint import ClassicalPaintSegmenter
from semloc_jax.perception.mask_offset import estimate_mask_offset

_LOG = logging.getLogger(__name__)
_OFFSET_FRAMES = 12
_IGNORED = 255
CLASSICAL = "classical"
"""Name of the built-in segmenter of road paint for plain images."""


@dataclass(frozen=True)
class MaskSource:
    """Masks of some cameras.

    Attributes:
        name: for messages and records.
        table: what the ids mean.
        cameras: names, in the order of the masks.
        segment: class ids uint8[h w] of one camera of a frame.
        offset_px: (du, dv) by which a camera's masks are off its images; what is at uv in the image is at uv + offset.
    """

    name: str
    table: ClassTable
    cameras: tuple[str, ...]
    segment: Callable[[Frame, str], np.ndarray]
    offset_px: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def masks(self, frame: Frame) -> list[np.ndarray]:
        """Class ids of every camera; moving objects that the data set knows are set to 255 (ignored)."""
        masks = []
        for camera in self.cameras:
            mask = self.segment(frame, camera)
            dynamic = frame.dynamic_mask(camera)
            masks.append(mask if dynamic is None else np.where(dynamic, _IGNORED, mask).astype(np.uint8))
        return masks

    def seen_by(self, rig: Rig) -> Rig:
        """The rig whose pixels are those of the masks: shifted by the offset of the masks."""
        shifted = [c.shifted(*self.offset_px.get(n, (0.0, 0.0))) for n, c in zip(rig.names, rig.cameras, strict=True)]
        return eqx.tree_at(lambda r: r.cameras, rig, tuple(shifted))


def mask_source(
    name: str,
    sequence: Sequence,
    cameras: Frames[str] | None = None,
    table: str | None = None,
    offset_px: tuple[float, float] | None = None,
) -> MaskSource:
    """Masks by name.

    Args:
        name: A mask folder of the sequence, or `classical` for the built-in segmenter of road paint.
        sequence: The drive.
        cameras: Names; None for all.
        table: Class table, a preset or a YAML file; None for that of the sequence.
        offset_px: Offset of the masks against the images; None estimates it from both where there are images.

    Raises:
        SemlocError: there are no such masks, or no class table is known.
    """
    names = tuple(cameras or sequence.rig.names)
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
    )
    _check_table(source, sequence)
    return source if offset_px is not None else _with_offsets(source, sequence)


def _classical(sequence: Sequence, names: tuple[str, ...]) -> MaskSource:
    rig = sequence.rig.select(names)
    segmenters = {camera: ClassicalPaintSegmenter(rig.cameras[i], rig.T_base_cam[i]) for i, camera in enumerate(names)}

    def segment(frame: Frame, camera: str) -> np.ndarray:
        return segmenters[camera](frame.image(camera))

    return MaskSource(CLASSICAL, load_class_table("lane_paint"), names, segment)


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
        images, masks = [f.image(camera) for f in frames], [source.segment(f, camera) for f in frames]
        try:
            offset = estimate_mask_offset(images, masks, source.table)
        except SemlocError as error:
            _LOG.warning("masks '%s' of %s: offset against the images not known: %s", source.name, camera, error)
            continue
        if offset.is_significant:
            offsets[camera] = (offset.du_px, offset.dv_px)
            _LOG.info("masks '%s' of %s sit (%+.2f, %+.2f) px off the images", source.name, camera, *offset[:2])
    return MaskSource(source.name, source.table, source.cameras, source.segment, offsets)


def _spread(frames: Frames[Frame], num: int) -> list[Frame]:
    """At most `num` frames, evenly spread."""
    return [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, num).astype(int))]
