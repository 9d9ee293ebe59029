"""Masks that are files: of the drive itself, or of a folder beside it (room: inputs; host).

In: the name of the masks, a Drive. Out: MaskFiles: class ids of one size for each camera.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import DamagedPicture, SemlocError
from semloc_jax.perception.class_table import UNLABELED_ID
from semloc_jax.perception.masks import read_mask

_LOG = logging.getLogger(__name__)
RECORD = "segment.yaml"
"""What `semloc segment` writes beside its masks."""
CLASSICAL = "classical"
"""Name of the built-in segmenter of road paint for plain images."""
NET = "net"
"""Name of the eyes that ship, for cameras that look along a road."""
NET_GARAGE = "net:garage"
"""Name of those that ship for fisheyes in garages."""
_MOST_STRETCH = 0.02
"""A network that works on whole cells may cut this share of a side; our choice."""


@dataclass(frozen=True)
class MaskFiles:
    """Masks of the cameras of a drive.

    Attributes:
        name: of the masks, for messages.
        read: what reads the mask of one camera of a frame.
        table: class table where it is known, else empty.
        sizes: (width, height) of the masks of each camera [px].
        size_px: the same, only of cameras whose masks are not as large as their images.
    """

    name: str
    read: Callable[[Frame, str], np.ndarray]
    table: str
    sizes: Mapping[str, tuple[int, int]]
    size_px: Mapping[str, tuple[int, int]]
    _told: set[str] = field(default_factory=set, repr=False, compare=False)

    @classmethod
    def of(cls, name: str, drive: Drive, cameras: tuple[str, ...]) -> "MaskFiles":
        """The masks of that name.

        Raises:
            SemlocError: there are none, or the first ones cannot be read.
        """
        read, table = _reader(name, drive, cameras)
        sizes, others = {}, {}
        for camera, model in zip(cameras, drive.rig.select(cameras).cameras, strict=True):
            height, width = _first_mask(read, drive.frames, camera).shape
            sizes[camera] = (width, height)
            if (width, height) != model.resolution:
                others[camera] = (width, height)
                _warn_of_stretch(name, camera, (width, height), model.resolution)
        return cls(name, read, table, sizes, others)

    def mask(self, frame: Frame, camera: str) -> np.ndarray:
        """Class ids uint8[h w]; a mask that is damaged, or not as large as the first of its camera, costs its frame:
        all of it is ignored, with a warning."""
        width, height = self.sizes[camera]
        try:
            mask = self.read(frame, camera)
        except DamagedPicture as error:
            self._warn_once(str(error), f"{error}; frame {frame.id} is taken without it")
        else:
            if mask.shape == (height, width):
                return mask
            size = f"{mask.shape[1]}x{mask.shape[0]}"
            self._warn_once(
                f"{camera} {size}",
                f"masks '{self.name}' of {camera}: frame {frame.id} has {size} px, the first one {width}x{height}; "
                "frames of that size are taken without it; make all masks of a camera in one way",
            )
        return np.full((height, width), UNLABELED_ID, np.uint8)

    def _warn_once(self, fault: str, message: str) -> None:
        """A mask is asked for more than once."""
        if fault not in self._told:
            self._told.add(fault)
            _LOG.warning("%s", message)


def _first_mask(read: Callable[[Frame, str], np.ndarray], frames: Sequence[Frame], camera: str) -> np.ndarray:
    """The first mask of a camera that is not damaged."""
    for frame in frames[:-1]:
        try:
            return read(frame, camera)
        except DamagedPicture:
            continue
    return read(frames[-1], camera)


def _warn_of_stretch(name: str, camera: str, mask_px: tuple[int, int], image_px: tuple[int, int]) -> None:
    across, down = (mask / image for mask, image in zip(mask_px, image_px, strict=True))
    if abs(across / down - 1.0) > _MOST_STRETCH:
        _LOG.warning(
            "masks '%s' of %s are %dx%d px, its images %dx%d: taken as the whole image, stretched; if it was cut, make "
            "masks of its shape",
            *(name, camera, *mask_px, *image_px),
        )


def _reader(name: str, drive: Drive, cameras: tuple[str, ...]) -> tuple[Callable[[Frame, str], np.ndarray], str]:
    """What reads the masks of a folder, and their class table where it is known."""
    if name in drive.mask_sources:
        return (lambda frame, camera: frame.mask(name, camera)), drive.table_name
    if Path(name).is_dir():
        return _from_folder(Path(name), cameras), _recorded_table(Path(name)) or drive.table_name
    known = ", ".join(
        (
            *drive.mask_sources,
            CLASSICAL,
            NET,
            NET_GARAGE,
            "FILE.onnx",
            "PRESET.yaml",
            "FILE.weights",
            "a folder CAMERA/FRAME.png",
        )
    )
    raise SemlocError(f"masks '{name}': drive {drive.name} has no such folder; expected one of {known}")


def _from_folder(folder: Path, names: tuple[str, ...]) -> Callable[[Frame, str], np.ndarray]:
    """Reads CAMERA/FRAME.png of a folder, or FRAME.png where the drive has one camera only."""

    def read(frame: Frame, camera: str) -> np.ndarray:
        own = folder / camera / f"{frame.id}.png"
        return read_mask(own if own.is_file() or len(names) > 1 else folder / f"{frame.id}.png")

    return read


def _recorded_table(folder: Path) -> str:
    """The class table that `semloc segment` has recorded with its masks; empty where there is no record."""
    path = folder / RECORD
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        key, _, value = line.partition(":")
        if key == "class_table":
            return value.strip().strip("'\"")
    return ""
