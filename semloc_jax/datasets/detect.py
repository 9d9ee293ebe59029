"""Which kind of recording a path is (room: datasets; host).

In: a path. Out: Drive.
"""

from collections.abc import Callable
from pathlib import Path

from semloc_jax.datasets.argoverse2 import is_argoverse2_log, read_argoverse2
from semloc_jax.datasets.bags import is_bag, read_bag
from semloc_jax.datasets.base import Drive
from semloc_jax.datasets.drive import is_drive, read_drive
from semloc_jax.datasets.entry import checked
from semloc_jax.datasets.euroc import is_euroc, read_euroc
from semloc_jax.datasets.folder import has_pictures, read_folder
from semloc_jax.datasets.kitti import is_kitti, read_kitti
from semloc_jax.datasets.nuscenes import is_nuscenes, read_nuscenes
from semloc_jax.datasets.pandaset import is_pandaset, read_pandaset
from semloc_jax.datasets.video import is_video, read_video
from semloc_jax.errors import SemlocError
from semloc_jax.storage import reading

_KINDS: tuple[tuple[str, Callable[[Path], bool], Callable[..., Drive]], ...] = (
    ("drive", is_drive, read_drive),
    ("bag", is_bag, read_bag),
    ("PandaSet", is_pandaset, read_pandaset),
    ("EuRoC", is_euroc, read_euroc),
    ("Argoverse 2", is_argoverse2_log, read_argoverse2),
    ("nuScenes", is_nuscenes, read_nuscenes),
    ("KITTI", is_kitti, read_kitti),
    ("video", is_video, read_video),
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
            f"data set {path}: no such folder or file; expected one of {', '.join(kind for kind, _, _ in _KINDS)}, or "
            "images + calib.yaml"
        )
    for kind, fits, read in _KINDS:
        if fits(path):
            if calibration is not None and kind in _OWN_CALIBRATION:
                raise SemlocError(
                    f"data set {path}: {kind} brings its own calibration; leave --calib {calibration} out"
                )
            with reading(f"{kind} {path}"):
                return checked(read(path) if calibration is None else read(path, calibration))
    if not path.is_dir():
        raise SemlocError(
            f"data set {path}: unknown type '{path.suffix}'; expected .bag, .db3, .mcap, .mp4, "
            ".avi, .mkv, .mov or a folder"
        )
    with reading(f"folder {path}"):
        return checked(read_folder(path, calibration))


def is_recording(path: Path) -> bool:
    """Whether a path is a recording and not a calibration: a folder with pictures, or a file of a known kind."""
    if any(fits(path) for _, fits, _ in _KINDS):
        return True
    return path.is_dir() and has_pictures(path)
