"""Which kind of recording a path is (room: datasets; host).

In: a path. Out: Drive.
"""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from semloc_jax.datasets.base import Drive
from semloc_jax.datasets.entry import checked
from semloc_jax.datasets.folder import has_pictures, read_folder
from semloc_jax.datasets.inertial import with_inertial_calibration
from semloc_jax.errors import SemlocError
from semloc_jax.storage import reading


class RecordingKind(NamedTuple):
    """A kind of recording: its name, its module, and what there tells it and reads it; loaded when it is asked."""

    name: str
    module: str
    told_by: str
    read_by: str

    def fits(self, path: Path) -> bool:
        """Whether a path is of this kind."""
        return self._of_module(self.told_by)(path)

    def read(self, path: Path, *calibration: str | Path) -> Drive:
        """The drive of a path of this kind."""
        return self._of_module(self.read_by)(path, *calibration)

    def _of_module(self, name: str) -> Callable:
        return getattr(importlib.import_module(self.module), name)


_KINDS = (
    RecordingKind("drive", "semloc_jax.datasets.drive", "is_drive", "read_drive"),
    RecordingKind("bag", "semloc_jax.datasets.bags", "is_bag", "read_bag"),
    RecordingKind("PandaSet", "semloc_jax.datasets.pandaset", "is_pandaset", "read_pandaset"),
    RecordingKind("EuRoC", "semloc_jax.datasets.euroc", "is_euroc", "read_euroc"),
    RecordingKind("Argoverse 2", "semloc_jax.datasets.argoverse2", "is_argoverse2_log", "read_argoverse2"),
    RecordingKind("nuScenes", "semloc_jax.datasets.nuscenes", "is_nuscenes", "read_nuscenes"),
    RecordingKind("KITTI", "semloc_jax.datasets.kitti", "is_kitti", "read_kitti"),
    RecordingKind("video", "semloc_jax.datasets.video", "is_video", "read_video"),
)
_OWN_CALIBRATION = ("PandaSet",)


def open_drive(path: str | Path, calibration: str | Path | None = None) -> Drive:
    """Drive of a recording whose type is guessed from its files; else a folder of images with a calibration.

    Args:
        path: file or folder.
        calibration: calibration file instead of what the recording says itself.

    Raises:
        SemlocError: there is no such path, it looks like nothing that is known, or a sensor has the wrong unit.

    >>> drive = sj.open_drive(folder)
    >>> len(drive), drive.rig.names, drive.mask_sources, drive.map_path.name
    (3, ('front',), ('sem', 'sem_net'), 'map.geojson')
    """
    path = Path(path)
    if not path.exists():
        raise SemlocError(
            f"data set {path}: no such folder or file; expected one of {', '.join(kind.name for kind in _KINDS)}, or "
            "images + calib.yaml"
        )
    for kind in _KINDS:
        if kind.fits(path):
            if calibration is not None and kind.name in _OWN_CALIBRATION:
                raise SemlocError(
                    f"data set {path}: {kind.name} brings its own calibration; leave --calib {calibration} out"
                )
            with reading(f"{kind.name} {path}"):
                drive = kind.read(path) if calibration is None else kind.read(path, calibration)
                return checked(with_inertial_calibration(drive, calibration))
    if not path.is_dir():
        raise SemlocError(
            f"data set {path}: unknown type '{path.suffix}'; expected .bag, .db3, .mcap, .mp4, "
            ".avi, .mkv, .mov or a folder"
        )
    with reading(f"folder {path}"):
        return checked(with_inertial_calibration(read_folder(path, calibration), calibration))


def is_recording(path: Path) -> bool:
    """Whether a path is a recording and not a calibration: a folder with pictures, or a file of a known kind."""
    if any(kind.fits(path) for kind in _KINDS):
        return True
    return path.is_dir() and has_pictures(path)
