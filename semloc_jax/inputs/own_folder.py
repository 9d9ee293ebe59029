"""What a folder of somebody's own pictures holds, under whatever names (room: inputs; host).

In: a folder. Out: folders of pictures that have to be moved, logs and numbers of the camera under other names.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semloc_jax.datasets.beside import FIXES
from semloc_jax.datasets.folder import PICTURE_SUFFIXES, kind_folders
from semloc_jax.datasets.pictures import read_picture
from semloc_jax.datasets.sensors import log_of
from semloc_jax.datasets.tables import read_numbers
from semloc_jax.errors import SemlocError

_TABLES, _NUMBERS = (".csv", ".tsv", ".txt"), (".txt", ".csv", ".dat")
_DISTORTIONS = ("d", "dist", "distortion", "distcoeffs", "dist_coeffs", "distortion_coeffs")
_MOST_IDS = 40
"""More ids than a class table has: photographs, or colours instead of ids."""


@dataclass(frozen=True)
class PictureFolder:
    """A folder of pictures under a name that is not looked for.

    Attributes:
        path: it.
        count: number of its pictures.
        holds_ids: whether they are masks.
    """

    path: Path
    count: int
    holds_ids: bool

    def __str__(self) -> str:
        return f"{self.path.name}/: {self.count} {'pictures of ids' if self.holds_ids else 'photographs'}"


def unplaced_pictures(path: Path) -> list[PictureFolder]:
    """Folders of pictures that are neither images/ nor masks/."""
    known = set(kind_folders(path).values())
    found = []
    for folder in sorted(place for place in path.iterdir() if place.is_dir() and place not in known):
        if files := pictures_in(folder):
            found.append(PictureFolder(folder, len(files), holds_ids(files[0])))
    return found


def moves_of(path: Path, folders: Sequence[PictureFolder]) -> list[str]:
    """Commands that put pictures where they are looked for; empty where only the owner can tell which is which."""
    wanted = [(folder, "masks" if folder.holds_ids else "images") for folder in folders]
    names = [name for _, name in wanted]
    return [f"mv {folder.path} {path / name}" for folder, name in wanted if names.count(name) == 1]


def pictures_in(folder: Path) -> list[Path]:
    """The pictures of a folder by name; none where there is no such folder."""
    if not folder.is_dir():
        return []
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in PICTURE_SUFFIXES)


def holds_ids(file: Path) -> bool:
    """Whether a picture is a mask: one channel with few values."""
    picture = read_picture(file)
    return picture.ndim == 2 and len(np.unique(picture)) <= _MOST_IDS


def ids_in(masks: Path) -> list[int]:
    """The ids in the first and the last mask of a folder; empty where they are no ids or cannot be read."""
    files = pictures_in(masks) or [file for folder in sorted(masks.iterdir()) for file in pictures_in(folder)]
    try:
        ids = sorted({int(value) for file in files[:1] + files[-1:] for value in np.unique(read_picture(file))})
    except SemlocError:
        return []
    return ids if len(ids) <= _MOST_IDS else []


def logs_of_other_names(path: Path) -> dict[str, str]:
    """Tables whose columns are those of a log, by the name that the log is looked for under."""
    found: dict[str, str] = {}
    known = (*FIXES, "imu.csv", "wheel_odom.csv", "times.csv")
    for file in sorted(path.iterdir()):
        if file.is_file() and file.suffix.lower() in _TABLES and file.name not in known:
            try:
                name = log_of(file)
            except SemlocError:
                continue
            if name is not None:
                found.setdefault(name, file.name)
    return found


def camera_matrix(path: Path) -> tuple[str, list[float]] | None:
    """The file that holds a camera matrix as 3 x 3 numbers, and fx, fy, cx, cy of it; None where there is none."""
    for file, rows in _tables_of_numbers(path):
        if rows.shape == (3, 3) and np.allclose(rows[2], [0, 0, 1]) and rows[1, 0] == 0.0 and rows[0, 0] > 0.0:
            return file.name, [float(rows[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2))]
    return None


def distortion(path: Path) -> tuple[str, list[float]] | None:
    """The file that is named after a distortion, with its 4 or 5 coefficients of OpenCV; None where there is none."""
    for file, rows in _tables_of_numbers(path):
        if file.stem.lower() in _DISTORTIONS and rows.size in (4, 5):
            return file.name, rows.ravel().tolist()
    return None


def _tables_of_numbers(path: Path) -> list[tuple[Path, np.ndarray]]:
    """Small files of numbers alone."""
    found = []
    for file in sorted(path.iterdir()):
        if file.is_file() and file.suffix.lower() in _NUMBERS and file.stat().st_size < 1000:
            try:
                found.append((file, read_numbers(file, None)))
            except SemlocError:
                continue
    return found
