"""SurroundPictures of all cameras around a vehicle, from a drive or from a folder with one picture for each camera
(room: inputs; host).

In: a path, a calibration. Out: SurroundPictures: the rig and its images frame by frame, checked against each other.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets import Drive, Frame, open_drive
from semloc_jax.datasets.base import IMAGE
from semloc_jax.datasets.detect import is_recording
from semloc_jax.datasets.pictures import as_colour, read_picture
from semloc_jax.errors import SemlocError
from semloc_jax.perception import load_class_table
from semloc_jax.perception.blind_pixels import blind_pixels
from semloc_jax.perception.target_pictures import PICTURE_SUFFIXES

_BLACK, _FLAT = 6.0, 2.0
"""Mean and spread of grey levels below which a picture shows nothing."""
_NUM_SAMPLES = 6
_STEADY = 0.99


@dataclass(frozen=True)
class SurroundPictures:
    """Images of all cameras of some frames.

    Attributes:
        where: for messages.
        rig: the cameras.
        names: of the frames.
        read: images uint8[h w 3], blue green red, of every camera, by index of the frame.
        drive: where they come from a drive.
        frames: of it.
        rate_hz: frames a second.
    """

    where: str
    rig: Rig
    names: tuple[str, ...]
    read: Callable[[int], list[np.ndarray]]
    drive: Drive | None = None
    frames: tuple[Frame, ...] = ()
    rate_hz: float = 1.0

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.names)

    def images(self, index: int) -> list[np.ndarray]:
        """The images of a frame, blue green red, in the order of the rig.

        Raises:
            SemlocError: one is black, or of another size than the calibration says.
        """
        images = self.read(index)
        for name, camera, image in zip(self.rig.names, self.rig.cameras, images, strict=True):
            place = f"{self.where}: frame {self.names[index]}, camera {name}"
            if (image.shape[1], image.shape[0]) != camera.resolution:
                raise SemlocError(
                    f"{place}: the image has {image.shape[1]}x{image.shape[0]} px, the calibration says "
                    f"{camera.resolution[0]}x{camera.resolution[1]}; give the calibration of these images (of another "
                    "car?)"
                )
            if image.mean() < _BLACK and image.std() < _FLAT:
                raise SemlocError(
                    f"{place}: the image is black; leave the frame out (--frames), or the camera (--cameras "
                    f"{','.join(n for n in self.rig.names if n != name)})"
                )
        return images

    def truth(self, index: int) -> np.ndarray | None:
        """True T_map_base of a frame; None where it is not known."""
        if self.drive is None or self.drive.truth is None:
            return None
        time_s = self.frames[index].time_s
        known = self.drive.truth.time_s[0] <= time_s <= self.drive.truth.time_s[-1]
        return self.drive.truth_at(self.frames[index]) if known else None


def surround_pictures(
    path: Path, calib: Path | None, cameras: tuple[str, ...] | None = None, frames: slice = slice(None)
) -> SurroundPictures:
    """The pictures of a drive, or of a folder with one picture for each camera.

    Raises:
        SemlocError: no such path, no calibration, a camera without a picture, no frames.
    """
    path = Path(path)
    if not path.exists():
        raise SemlocError(f"{path}: no such file or folder; expected a drive, or a folder with one picture a camera")
    return _of_drive(path, calib, cameras, frames) if is_recording(path) else _of_folder(path, calib, cameras)


def pictures_by_camera(folder: Path, names: tuple[str, ...]) -> dict[str, Path]:
    """The file of a folder that has the name of a camera in its own, for each camera that has one."""
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in PICTURE_SUFFIXES)
    found = {name: next((file for file in files if name.lower() in file.stem.lower()), None) for name in names}
    return {name: file for name, file in found.items() if file is not None}


def own_bodies(pictures: SurroundPictures) -> list[np.ndarray | None]:
    """Pixels of each camera that never show the world, bool[h w]: black ones, and the own car where masks know it."""
    if pictures.drive is None:
        return [blind_pixels([image]) for image in pictures.images(0)]
    chosen = np.unique(np.linspace(0, len(pictures) - 1, _NUM_SAMPLES).astype(int))
    samples = [pictures.images(int(k)) for k in chosen]
    blind: list[np.ndarray | None] = []
    for camera, name in enumerate(pictures.rig.names):
        own = blind_pixels([images[camera] for images in samples])
        body = _labelled_body(pictures, [pictures.frames[k] for k in chosen], name)
        blind.append(own if body is None or body.shape != own.shape else own | body)
    return blind


def _labelled_body(pictures: SurroundPictures, frames: list[Frame], camera: str) -> np.ndarray | None:
    """Pixels that masks call the own car in nearly all of some frames."""
    drive = pictures.drive
    if drive is None or not drive.mask_sources or not drive.table_name:
        return None
    ids, kind = load_class_table(drive.table_name).ego_ids, drive.mask_sources[0]
    known = [np.isin(f.mask(kind, camera), ids) for f in frames if f.has(kind, camera)]
    return np.mean(known, axis=0) >= _STEADY if known and ids else None


def _of_drive(path: Path, calib: Path | None, cameras: tuple[str, ...] | None, frames: slice) -> SurroundPictures:
    drive = open_drive(path, calib)
    rig = drive.rig.select(cameras) if cameras else drive.rig
    chosen = drive.frames[frames]
    if not chosen:
        raise SemlocError(f"drive {drive.name}: no frames chosen of {len(drive)}; check --frames")
    if not any(chosen[0].has(IMAGE, name) for name in rig.names):
        raise SemlocError(
            f"drive {drive.name}: has no images; expected pictures of its cameras (semloc slots works on masks alone)"
        )
    for name in rig.names:
        missing = next((f.id for f in chosen if not f.has(IMAGE, name)), None)
        if missing is not None:
            raise SemlocError(
                f"drive {drive.name}: camera {name} has no image in frame {missing}; add it, or go without the camera: "
                f"--cameras {','.join(n for n in rig.names if n != name)}"
            )
    times = np.array([f.time_s for f in chosen])
    rate_hz = 1.0 / max(float(np.median(np.diff(times))), 1e-3) if len(times) > 1 else 1.0

    def read(index: int) -> list[np.ndarray]:
        return [chosen[index].image(name) for name in rig.names]

    return SurroundPictures(
        f"drive {drive.name}", rig, tuple(f.id for f in chosen), read, drive, tuple(chosen), rate_hz
    )


def _of_folder(path: Path, calib: Path | None, cameras: tuple[str, ...] | None) -> SurroundPictures:
    if calib is None and not (path / "calib.yaml").is_file():
        raise SemlocError(f"{path}: no drive and no calib.yaml in it; give --calib, a calibration of all cameras")
    rig = read_calibration(calib if calib is not None else path / "calib.yaml")
    rig = rig.select(cameras) if cameras else rig
    files = pictures_by_camera(path, rig.names) if path.is_dir() else {}
    missing = [name for name in rig.names if name not in files]
    if missing:
        there = ", ".join(sorted(f.name for f in path.iterdir() if f.suffix.lower() in PICTURE_SUFFIXES)[:8]) or "none"
        left = ",".join(name for name in rig.names if name in files)
        raise SemlocError(
            f"{path}: no picture of camera {', '.join(missing)} (there: {there}); expected one with the name of each "
            f"camera of the calibration in its own ({', '.join(rig.names)}); add it"
            + (f", or go on with --cameras {left}" if left else "")
        )
    return SurroundPictures(
        str(path), rig, ("0",), lambda _: [as_colour(read_picture(files[name])) for name in rig.names]
    )
