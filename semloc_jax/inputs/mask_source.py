"""Where the masks of a frame come from (room: inputs; host).

In: a Drive and the name of a mask folder or segmenter. Out: MaskSource.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_files import CLASSICAL, NET, NET_GARAGE, MaskFiles
from semloc_jax.inputs.mask_view import MaskSource, TopViewSource, resized
from semloc_jax.inputs.paint_and_eyes import paint_channel, with_paint
from semloc_jax.perception import load_class_table, preset_names
from semloc_jax.perception.class_table import part_of_table
from semloc_jax.perception.classical_paint import ClassicalPaintSegmenter
from semloc_jax.perception.mask_offset import MaskOffset, estimate_mask_offset, offsets_of_cameras
from semloc_jax.perception.network import NetworkPreset, NetworkSegmenter, load_network_preset
from semloc_jax.perception.networks.eyes import SHIPPED, SHIPPED_GARAGE, Eyes
from semloc_jax.perception.surround import ground_table, top_view
from semloc_jax.runtime.memory import remembered

_LOG = logging.getLogger(__name__)
_OFFSET_FRAMES = 12
_MAX_OFFSET_PX = 2.0
"""Masks made at a fourth of the resolution and resized by their corners lie 1.5 px off; a larger estimate comes from
lines that fix only one direction."""
CLASSICAL_AND = CLASSICAL + "+"
"""Before the name of eyes: paint by the built-in segmenter, all else by the eyes."""
_SHIPPED = {NET: SHIPPED, NET_GARAGE: SHIPPED_GARAGE}
TOP_VIEW = "ipm:"
"""Before the name of masks: all cameras as one top view of the road (inverse perspective mapping)."""


def mask_source(
    name: str,
    drive: Drive,
    cameras: Sequence[str] | None = None,
    table: str | None = None,
    offset_px: tuple[float, float] | None = None,
) -> MaskSource:
    """Masks by name.

    Args:
        name: A mask folder of the drive, any folder with CAMERA/FRAME.png, a network `FILE.onnx` (with its preset
            FILE.yaml beside it) or its preset `FILE.yaml`, eyes that a map or random streets have taught
            `FILE.weights`, those that ship, `net` for roads and `net:garage` for fisheyes in garages, `classical` for
            the built-in segmenter of road paint, or `classical+FILE.weights` for its paint and the other classes of
            eyes; `ipm:` before any of them makes one top view of the road of all cameras.
        drive: The drive.
        cameras: Names; None for all that have such masks.
        table: Class table, a preset or a YAML file; None for that of the drive or of the network's preset. Eyes have
            their own: a table with fewer of its channels leaves the others out.
        offset_px: Offset of the masks against the images; None estimates it from both where there are images.

    Raises:
        SemlocError: there are no such masks, or no class table is known.

    >>> masks = sj.mask_source("sem", drive)
    >>> masks.masks(drive.frames[0])[0].shape, masks.table.name
    ((300, 480), 'drive')
    """
    if name.startswith(TOP_VIEW):
        return _top_view(mask_source(name.removeprefix(TOP_VIEW), drive, cameras, table, offset_px), drive)
    first = drive.frames[0]
    names = tuple(cameras or [n for n in drive.rig.names if first.has(name, n)] or drive.rig.names)
    drive.rig.select(names)
    if name == CLASSICAL:
        return _classical(drive, names)
    if name.startswith(CLASSICAL_AND):
        return _paint_and_eyes(name, drive, names)
    if is_eyes(name):
        source = eyes_source(_eyes(name), names, name)
        return source if table is None else replace(source, table=part_of_table(source.table, load_class_table(table)))
    if is_network(name):
        return _network(name, drive, names, table)
    files = MaskFiles.of(name, drive, names)
    table = table or files.table
    if not table:
        raise SemlocError(
            f"masks '{name}': no class table is known for {drive.name}; give --class-table "
            f"{', '.join(preset_names())} or a YAML file"
        )
    source = MaskSource(
        name,
        load_class_table(table),
        names,
        files.mask,
        {} if offset_px is None else dict.fromkeys(names, offset_px),
        files.size_px,
    )
    _check_table(source, drive)
    return source if offset_px is not None else _with_offsets(source, drive)


def best_masks(drive: Drive) -> str:
    """Name of the masks that a drive has itself, the best first.

    Raises:
        SemlocError: it has none.
    """
    if not drive.mask_sources:
        raise SemlocError(
            f"drive {drive.name}: has no masks; give --masks {NET} or {CLASSICAL}, which are made of its images, or "
            "make some with your own network (semloc segment)"
        )
    return drive.mask_sources[0]


def _classical(drive: Drive, names: tuple[str, ...]) -> MaskSource:
    rig = drive.rig.select(names)
    segmenters = {camera: ClassicalPaintSegmenter(rig.cameras[i], rig.T_base_cam[i]) for i, camera in enumerate(names)}

    def segment(frame: Frame, camera: str) -> np.ndarray:
        image, traffic = frame.image(camera), frame.dynamic_mask(camera)
        return segmenters[camera](image, traffic=None if traffic is None else resized(traffic, image[..., 0]))

    # A table with posts says that all posts are found: only where uprights stand along the columns of the image.
    shows_posts = any(segmenter.shows_posts for segmenter in segmenters.values())
    return MaskSource(CLASSICAL, load_class_table("classical" if shows_posts else "lane_paint"), names, segment)


def made_of_images(name: str) -> bool:
    """Whether masks of this name are made while they are asked for, not read from files."""
    plain = name.removeprefix(TOP_VIEW)
    return plain == CLASSICAL or plain.startswith(CLASSICAL_AND) or is_network(name)


def is_network(name: str) -> bool:
    """Whether masks of this name come from a network that runs on the images."""
    return Path(name.removeprefix(TOP_VIEW)).suffix.lower() in (".onnx", ".yaml", ".yml") or is_eyes(name)


def is_eyes(name: str) -> bool:
    """Whether masks of this name come from eyes that a map has taught: they know how far and how sure a border is."""
    plain = name.removeprefix(TOP_VIEW)
    return plain in _SHIPPED or Path(plain).suffix.lower() == ".weights"


def _eyes(name: str) -> Eyes:
    """Those that ship, or those of a file."""
    return Eyes.load(_SHIPPED.get(name, name))


def eyes_source(eyes: Eyes, names: Sequence[str], name: str = "eyes") -> MaskSource:
    """Masks of eyes on the images of a drive; the last frames are kept, since they are asked for more than once.

    Args:
        eyes: The network.
        names: Of the cameras.
        name: Of the masks, for messages.
    """

    def see(frame: Frame, camera: str) -> np.ndarray:
        return eyes(frame.image(camera))

    return MaskSource(name, eyes.table, tuple(names), _kept(see, 2 * len(names)), knows_borders=True)


def _paint_and_eyes(name: str, drive: Drive, names: tuple[str, ...]) -> MaskSource:
    """Paint of the built-in segmenter, all else of eyes."""
    eyes, classical = _eyes(name.removeprefix(CLASSICAL_AND)), _classical(drive, names)
    channel, (drawn_id,) = paint_channel(eyes.table), classical.table.channels[0].mask_ids

    def see(frame: Frame, camera: str) -> np.ndarray:
        return with_paint(eyes(frame.image(camera)), classical.segment(frame, camera), drawn_id, channel)

    return MaskSource(name, eyes.table, names, _kept(see, 2 * len(names)), knows_borders=True)


def _kept(see: Callable[[Frame, str], np.ndarray], most: int) -> Callable[[Frame, str], np.ndarray]:
    """The same function, which remembers its last masks: they are asked for more than once."""
    kept: dict[tuple[str, str], np.ndarray] = {}

    def seen(frame: Frame, camera: str) -> np.ndarray:
        key = (frame.id, camera)
        if key not in kept:
            while len(kept) >= most:
                kept.pop(next(iter(kept)))
            kept[key] = see(frame, camera)
        return kept[key]

    return seen


def _network(name: str, drive: Drive, names: tuple[str, ...], table: str | None) -> MaskSource:
    """Masks of a network that runs on the images.

    Raises:
        SemlocError: the file is missing or no network, no class table is known, or it does not fit what comes out.
    """
    preset = network_preset(Path(name))
    if not (table or preset.class_table):
        raise SemlocError(f"network {name}: what its class ids mean is not known; give --class-table")
    network = NetworkSegmenter(preset)
    kept: dict[tuple[str, str], np.ndarray] = {}

    def segment(frame: Frame, camera: str) -> np.ndarray:
        found = kept.get((frame.id, camera))
        return network(frame.image(camera)) if found is None else found

    source = MaskSource(name, load_class_table(table or preset.class_table), names, segment)
    # A network takes its time: the masks that are looked at first are not made twice.
    kept |= {(frame.id, camera): segment(frame, camera) for frame in looked_at(drive.frames) for camera in names}
    _check_table(source, drive)
    return source


def network_preset(path: Path) -> NetworkPreset:
    """The preset of a network: the file itself, the one beside the ONNX file, or all defaults."""
    if path.suffix.lower() != ".onnx":
        return load_network_preset(path)
    beside = path.with_suffix(".yaml")
    return replace(load_network_preset(beside) if beside.is_file() else NetworkPreset(), model=str(path))


def _top_view(source: MaskSource, drive: Drive) -> TopViewSource:
    """The source as a top view of what its cameras see."""
    rig = drive.rig.select(source.cameras)
    return TopViewSource(
        TOP_VIEW + source.name,
        ground_table(source.table),
        source.cameras,
        source.segment,
        source.offset_px,
        source.size_px,
        source.knows_borders,
        *top_view(rig),
    )


def _check_table(source: MaskSource, drive: Drive) -> None:
    """Refuse a class table that does not fit the masks: it would localize on nonsense.

    Raises:
        SemlocError: the table and the masks do not fit.
    """
    frames = looked_at(drive.frames)
    report = source.table.report(source.segment(frame, camera) for frame in frames for camera in source.cameras)
    if not report.fits:
        raise SemlocError(
            f"masks '{source.name}' do not fit class table {source.table.name}: {report.problems[0]}; "
            "give --class-table, a preset or a YAML file"
        )


def looked_at(frames: Sequence[Frame]) -> list[Frame]:
    """The frames whose masks are looked at before the work: a few, spread over the drive."""
    return _spread(frames, 4)


def _with_offsets(source: MaskSource, drive: Drive) -> MaskSource:
    """The source with the offset of each camera's masks where it has one; see `offsets_of_cameras`."""
    rig = zip(drive.rig.names, drive.rig.cameras, strict=True)
    size_px = {name: source.size_px.get(name, camera.resolution) for name, camera in rig}
    found = {camera: _found_offset(source, drive, camera) for camera in source.cameras}
    offsets = offsets_of_cameras(found, size_px)
    for camera, (du_px, dv_px) in offsets.items():
        own = found[camera]
        told = "" if own is not None and own.is_significant else ", as those of the other cameras"
        _LOG.info("masks '%s' of %s sit (%+.2f, %+.2f) px off the images%s", source.name, camera, du_px, dv_px, told)
    return replace(source, offset_px=offsets)


def _found_offset(source: MaskSource, drive: Drive, camera: str) -> MaskOffset | None:
    """The offset that some frames of a camera show; None where it has no images or they show none."""
    frames = [frame for frame in _spread(drive.frames, _OFFSET_FRAMES) if frame.has("rgb", camera)]
    if not frames:
        return None
    try:
        offset = _offset(source, frames, camera)
    except SemlocError as error:
        _LOG.warning("masks '%s' of %s: offset against the images not known: %s", source.name, camera, error)
        return None
    if max(abs(offset.du_px), abs(offset.dv_px)) > _MAX_OFFSET_PX:
        _LOG.warning(
            "masks '%s' of %s: estimated (%+.1f, %+.1f) px off the images, implausible; taken as 0",
            *(source.name, camera, offset.du_px, offset.dv_px),
        )
        return None
    return offset


def _offset(source: MaskSource, frames: Sequence[Frame], camera: str) -> MaskOffset:
    """The offset from some frames, remembered between processes where the masks are files of the drive."""

    def find() -> MaskOffset:
        masks = [source.segment(frame, camera) for frame in frames]
        images = [resized(frame.image(camera), mask) for frame, mask in zip(frames, masks, strict=True)]
        return estimate_mask_offset(images, masks, source.table)

    if not all(frame.has(source.name, camera) for frame in frames):
        return find()
    files = [frame.path(kind, camera) for frame in frames for kind in ("rgb", source.name)]
    if not all(isinstance(file, Path) for file in files):  # messages of a bag have no time of change
        return find()
    return MaskOffset(*remembered("mask_offset_of_groups", source.table, files, find))


def _spread(frames: Sequence[Frame], num: int) -> list[Frame]:
    """At most `num` frames, evenly spread."""
    return [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, num).astype(int))]
