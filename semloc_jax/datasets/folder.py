"""A plain folder of images and masks with a calibration (room: datasets; host).

In: images/ (or rgb/) and masks/ (labels/, sem/), in any case of letters, each with one folder per camera or, for one
camera, the files themselves; calib.yaml or any calibration the cameras room reads; optionally times.csv,
timestamps.txt or file names that are times, gps.csv or NMEA, wheel_odom.csv, imu.csv, poses.tum and a map. Out: Drive.
"""

import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets.base import IMAGE, Drive, Frame
from semloc_jax.datasets.beside import CALIBRATIONS, folder_file, logs_beside, maps_in
from semloc_jax.datasets.clock import TIME_NAMES, seconds
from semloc_jax.datasets.tables import column_names, read_numbers, read_rows
from semloc_jax.datasets.templates import COLUMNS
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory

_log = logging.getLogger(__name__)
_IMAGE_FOLDERS, _MASK_FOLDERS = ("images", "image", "rgb"), ("masks", "labels", "sem")
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
_FIRST_WORDS = re.compile(r"(?:[0-9]*[A-Za-z][A-Za-z0-9]*[_.-])*[A-Za-z]*")
"""Words that begin or, read backwards, end a name; the numbers that tell files apart are none."""
_ByKind = Mapping[str, Mapping[str, Mapping[str, Path]]]
_MIN_STAMP_DIGITS = 9
"""File names with this many digits are times, not numbers of pictures; our choice."""


def read_folder(
    path: str | Path, calibration: str | Path | None = None, table_name: str = "", rate_hz: float = 10.0
) -> Drive:
    """Drive of a folder of files.

    Files of different kinds and cameras belong together by their stem, without what all files of one kind have before
    or behind it (`frame_7.jpg` and `frame_7_mask.png`). Masks are called by the name of their folder. Times come from
    `times.csv` (columns frame, t), from `timestamps.txt` (one for each picture), from file names of nine and more
    digits or, where there are as many poses as frames, from the poses; else frames follow each other at `rate_hz`.

    Args:
        path: folder.
        calibration: calibration file where it does not lie in the folder.
        table_name: class table of the masks.
        rate_hz: frame rate where nothing states times.

    Raises:
        SemlocError: no calibration, no files, or files that do not fit the cameras.
    """
    path = Path(path)
    rig = read_calibration(calibration if calibration is not None else _find_calibration(path))
    by_kind = {kind: _files_of(folder, rig) for kind, folder in kind_folders(path).items()}
    if not by_kind:
        raise SemlocError(f"folder {path}: no images; expected a folder images/ or masks/ with png or jpg files")
    stems, by_kind = _named_alike(path, by_kind, rig)
    logs = logs_beside(path)
    truth = logs.truth
    times = _frame_times(path, stems, truth, rate_hz)
    if truth is not None and len(truth) == len(stems):
        truth = Trajectory(times, truth.T_map_base)
    frames = tuple(
        Frame(
            index=index,
            id=stem,
            time_s=float(times[index]),
            variant="",
            rig=rig,
            files={kind: {camera: files[camera][stem] for camera in rig.names} for kind, files in by_kind.items()},
        )
        for index, stem in enumerate(stems)
    )
    return Drive(
        name=path.resolve().name,
        path=path,
        frames=frames,
        rig=rig,
        table_name=table_name,
        mask_sources=tuple(kind for kind in by_kind if kind != IMAGE),
        maps=maps_in(path),
        truth=truth,
        gnss=logs.gnss,
        odometry=logs.odometry,
        imu=logs.imu,
    )


def has_pictures(path: Path) -> bool:
    """Whether a folder has a folder of images or masks."""
    return bool(kind_folders(path))


def kind_folders(path: Path) -> dict[str, Path]:
    """Folders of pictures by kind: IMAGE, and each folder of masks under its own name."""
    found: dict[str, Path] = {}
    folders = sorted(place for place in path.iterdir() if place.is_dir()) if path.is_dir() else []
    for name in (*_IMAGE_FOLDERS, *_MASK_FOLDERS):
        for folder in folders:
            if folder.name.lower() == name:
                found.setdefault(IMAGE if name in _IMAGE_FOLDERS else folder.name, folder)
    return found


def are_times(stems: Sequence[str]) -> bool:
    """Whether all names of files are times: nine digits and more."""
    bare = [stem.replace(".", "", 1) for stem in stems]
    return bool(bare) and all(stem.isdigit() and len(stem) >= _MIN_STAMP_DIGITS for stem in bare)


def _find_calibration(path: Path) -> Path:
    found = folder_file(path, CALIBRATIONS)
    if found is None:
        raise SemlocError(
            f"folder {path}: no calibration; expected one of {', '.join(CALIBRATIONS)}; give --calib FILE, or let "
            f"'semloc init {path}' write one to fill in"
        )
    return found


def _named_alike(path: Path, by_kind: _ByKind, rig: Rig) -> tuple[list[str], _ByKind]:
    """Names of the frames, and the files by them.

    Raises:
        SemlocError: no name is shared by all kinds and cameras.
    """
    stems = _shared_stems(by_kind, rig)
    if stems:
        return stems, by_kind
    told_apart = _without_affixes(by_kind)
    stems = _shared_stems(told_apart, rig)
    # Numbers of which each side has some alone may count from 0 here and from 1 there: no guess is made.
    fewest = min(len(files) for cameras in told_apart.values() for files in cameras.values())
    if stems and len(stems) == fewest:
        names = _names_of(by_kind)
        _log.warning("folder %s: names are compared without the words that all in a folder share: %s", path, names)
        return stems, told_apart
    raise SemlocError(
        f"folder {path}: no file name is shared by all of {', '.join(by_kind)} and all cameras: "
        f"{_names_of(by_kind)}; expected the same name for an image and its mask, e.g. images/front/000.png and "
        "masks/front/000.png"
    )


def _shared_stems(by_kind: _ByKind, rig: Rig) -> list[str]:
    """Names that every kind and camera has; frame_2 comes before frame_10."""
    shared = set.intersection(*(set(files[camera]) for files in by_kind.values() for camera in rig.names))
    return sorted(shared, key=_by_number)


def _by_number(name: str) -> list[str | int]:
    """Words and numbers of a name by turns, to sort by."""
    return [int(part) if at % 2 else part for at, part in enumerate(re.split(r"(\d+)", name))]


def _without_affixes(by_kind: _ByKind) -> _ByKind:
    """The files by what is left of their stems without what all of one folder have in common at its ends."""
    found = {}
    for kind, cameras in by_kind.items():
        found[kind] = {camera: _told_apart(files) for camera, files in cameras.items()}
    return found


def _told_apart(files: Mapping[str, Path]) -> Mapping[str, Path]:
    """Files by their stem without a common word before or behind it, such as `mask_` or `_labelIds`."""
    stems = list(files)
    if len(stems) < 2:
        return files
    start, end = (_first_words(names) for names in (stems, [stem[::-1] for stem in stems]))
    return {stem[start : len(stem) - end]: file for stem, file in files.items()}


def _first_words(names: Sequence[str]) -> int:
    """Length of the words with which all names begin."""
    shared = next((at for at, marks in enumerate(zip(*names, strict=False)) if len(set(marks)) > 1), len(names[0]))
    words = _FIRST_WORDS.match(names[0][:shared])
    return words.end() if words else 0


def _files_of(folder: Path, rig: Rig) -> Mapping[str, Mapping[str, Path]]:
    """Files by camera and stem; a folder without camera folders belongs to the only camera of the rig."""
    if len(rig) == 1 and not (folder / rig.names[0]).is_dir():
        return {rig.names[0]: _of_only_camera(folder, rig.names[0])}
    missing = [camera for camera in rig.names if not (folder / camera).is_dir()]
    if missing:
        raise SemlocError(
            f"folder {folder}: no folder for camera {', '.join(missing)}; expected one for each camera of the "
            f"calibration: {', '.join(rig.names)}; there are {', '.join(_camera_folders(folder)) or 'none'}: rename "
            "the folders, or the cameras of the calibration by the key 'name'"
        )
    return {camera: _pictures(folder / camera) for camera in rig.names}


def _of_only_camera(folder: Path, name: str) -> dict[str, Path]:
    """Pictures of the only camera: in the folder itself, or in the one folder in it, whatever its name."""
    pictures, folders = _pictures(folder), _camera_folders(folder)
    if pictures or not folders:
        return pictures
    if len(folders) > 1:
        raise SemlocError(
            f"folder {folder}: has folders of the cameras {', '.join(folders)}, and the calibration knows '{name}' "
            "alone; expected one folder of that name; rename it, or the camera by the key 'name' of the calibration"
        )
    _log.warning("folder %s: its one folder '%s' is taken for the one camera '%s'", folder, folders[0], name)
    return _pictures(folder / folders[0])


def _camera_folders(folder: Path) -> list[str]:
    return sorted(place.name for place in folder.iterdir() if place.is_dir())


def _names_of(by_kind: _ByKind) -> str:
    """How many files there are of each kind and camera, and what the first is called."""
    said = []
    for kind, cameras in by_kind.items():
        for camera, files in cameras.items():
            first = f" ({next(iter(files.values())).name} ...)" if files else ""
            said.append(f"{len(files)} {kind} of {camera}{first}")
    return ", ".join(said)


def _pictures(folder: Path) -> dict[str, Path]:
    return {file.stem: file for file in sorted(folder.iterdir()) if file.suffix.lower() in PICTURE_SUFFIXES}


def _frame_times(path: Path, stems: list[str], truth: Trajectory | None, rate_hz: float) -> np.ndarray:
    if (path / "times.csv").is_file():
        return _listed_times(path, stems)
    if (path / "timestamps.txt").is_file():
        values = read_numbers(path / "timestamps.txt", None)[:, -1]
        if len(values) != len(stems):
            raise SemlocError(
                f"folder {path}: timestamps.txt has {len(values)} rows for {len(stems)} frames; expected one each"
            )
        return seconds(values, f"folder {path}: timestamps.txt")[0]
    if are_times(stems):
        whole = all(stem.isdigit() and len(stem) <= 19 for stem in stems)
        stamps = np.array([int(stem) for stem in stems], dtype=np.int64) if whole else np.array(stems, dtype=np.float64)
        return seconds(stamps, f"folder {path}: file names")[0]
    if truth is not None and len(truth) == len(stems) and np.ptp(truth.time_s) != len(stems) - 1:
        return truth.time_s
    _log.warning(
        "folder %s: nothing states times; frames are taken to be %g s apart. Write times.csv: %s",
        *(path, 1.0 / rate_hz, COLUMNS["times.csv"].strip().replace("\n", " | ")),
    )
    return np.arange(len(stems)) / rate_hz


def _listed_times(path: Path, stems: list[str]) -> np.ndarray:
    file = path / "times.csv"
    names = column_names(file, {"time": TIME_NAMES, "frame": ("frame", "name", "file", "filename", "image")})
    if names.keys() != {"time", "frame"}:
        raise SemlocError(f"table {file}: expected the columns frame and t (or t_ms, t_us, t_ns)")
    rows = {Path(row[names["frame"]] or "").stem: row[names["time"]] for row in read_rows(file, ())}
    absent = [stem for stem in stems if stem not in rows]
    if absent:
        raise SemlocError(f"folder {path}: times.csv has no row for frame {absent[0]}; expected one for each frame")
    cells = [(rows[stem] or "").strip() for stem in stems]
    try:
        # Whole nanoseconds do not fit the digits of a float64.
        is_whole = all(cell.isdigit() and len(cell) <= 19 for cell in cells)
        values = (
            np.array([int(cell) for cell in cells], dtype=np.int64)
            if is_whole
            else np.array([float(cell) for cell in cells])
        )
    except (ValueError, OverflowError) as error:
        raise SemlocError(f"table {file}: {error}; expected a time for each frame") from error
    return seconds(values, f"table {file}", names["time"])[0]
