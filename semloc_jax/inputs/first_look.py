"""What is there of somebody's own data, what is missing, and what to do next (room: inputs; host).

In: a folder, bag or video. Out: FirstLook, and templates of what is missing beside it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets import open_drive
from semloc_jax.datasets.beside import CALIBRATIONS, FIXES, calibration_beside, folder_file, maps_beside
from semloc_jax.datasets.drive import is_drive
from semloc_jax.datasets.folder import has_pictures
from semloc_jax.datasets.pictures import read_picture
from semloc_jax.datasets.templates import CLASSES, COLUMNS, calibration_template
from semloc_jax.errors import SemlocError
from semloc_jax.perception import preset_names

_IMAGES, _MASKS = ("images", "image", "rgb"), ("masks", "labels", "sem")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
_MAPS = (".osm", ".xodr", ".gpkg", ".geojson", ".smap")
_CALIBRATIONS = (".yaml", ".yml", ".xml")
_MOST_IDS = 40
"""More ids than a class table has: photographs, or colours instead of ids."""


@dataclass(frozen=True)
class FirstLook:
    """What was found.

    Attributes:
        found: one line for each thing that is there.
        missing: one line for each thing that is not, with what it is needed for.
        written: templates that were written.
        command: what to run next.
    """

    found: tuple[str, ...]
    missing: tuple[str, ...]
    written: tuple[Path, ...]
    command: str

    def to_text(self) -> str:
        """Returns all of it as lines of text."""
        lines = [f"found    {line}" for line in self.found] + [f"missing  {line}" for line in self.missing]
        lines += [f"written  {path}: replace the words in capitals" for path in self.written]
        return "\n".join([*lines, "", f"next: {self.command}"])


def first_look(path: str | Path) -> FirstLook:
    """Look at a recording; write calib.yaml and classes.yaml to fill in where they are missing.

    Nothing that is there is changed.

    Raises:
        SemlocError: there is no such path.
    """
    path = Path(path)
    if not path.exists():
        raise SemlocError(f"{path}: no such folder or file; expected images/ with png or jpg files, a bag or a video")
    if path.is_dir() and (is_drive(path) or not has_pictures(path)):
        try:
            return _of_drive(path)  # a data set with a layout of its own
        except SemlocError as error:
            return _without_pictures(path, error)
    return _of_folder(path) if path.is_dir() else _of_file(path)


def _without_pictures(path: Path, error: SemlocError) -> FirstLook:
    """A folder without images/: its pictures may lie in folders of other names."""
    own = [(folder, _pictures(folder)) for folder in sorted(path.iterdir()) if folder.is_dir()]
    own = [(folder, files) for folder, files in own if files]
    if not own:
        return FirstLook((), (f"pictures: {error}",), (), f"semloc init {path}  (once images/ is there)")
    names = ["masks" if _holds_ids(read_picture(files[0])) else "images" for _, files in own]
    found = [
        f"{folder.name}/: {len(files)} {'pictures of ids' if name == 'masks' else 'photographs'}"
        for (folder, files), name in zip(own, names, strict=True)
    ]
    missing = "images/: photographs are looked for in images/, masks in masks/ (with a folder for each camera in them)"
    free = [n for n in names if names.count(n) == 1]
    moves = [f"mv {folder} {path / name}" for (folder, _), name in zip(own, names, strict=True) if name in free] or [
        f"mkdir {path / 'images'}, move a folder for each camera there"
    ]
    return FirstLook(tuple(found), (missing,), (), "; ".join([*moves, f"semloc init {path}"]))


def _of_file(path: Path) -> FirstLook:
    """A bag or a video: its calibration may have to lie beside it."""
    if calibration_beside(path) is None:
        try:
            return _of_drive(path)
        except SemlocError as error:
            written = _write(path.parent / "calib.yaml", calibration_template(["front"], [None]))
            return FirstLook((f"{path.name}",), (f"calibration: {error}",), written, f"semloc init {path}")
    return _of_drive(path)


def _of_folder(path: Path) -> FirstLook:
    """A folder of pictures: every part is looked at by itself, so that one that is wrong hides no other."""
    found, missing, written = [], [], []
    cameras = _cameras(path)
    masks = next((path / name for name in _MASKS if (path / name).is_dir()), None)
    for name, (count, size) in cameras.items():
        found.append(f"camera {name}: {count} pictures" + (f" of {size[0]}x{size[1]} px" if size else ""))
    if next((name for name in CALIBRATIONS if (path / name).is_file()), None) is None:
        missing.append("calibration: intrinsics and place of each camera" + _other_calibrations(path))
        written += _write(path / "calib.yaml", calibration_template(list(cameras), [s for _, s in cameras.values()]))
    else:
        found.append(_calibration_line(path, missing))
    if masks is None:
        missing.append(
            "masks/: semloc segment makes them with a network; --masks classical finds road paint without one"
        )
    else:
        tables = ", ".join(preset_names())
        found.append(f"masks in {masks.name}/{_ids(masks)}: --class-table {tables}, or your own classes.yaml")
        written += _write(path / "classes.yaml", CLASSES)
    for name, use in (
        ("times.csv", "time of each frame; else file names, else 10 Hz is assumed"),
        ("gps.csv", "where to start; else --prior FILE.tum, or --area X,Y,RADIUS for track"),
        ("wheel_odom.csv", "how the vehicle moves; else constant velocity between frames"),
        ("imu.csv", "turns between frames"),
    ):
        example = COLUMNS[name].split("\n")
        here = folder_file(path, FIXES if name == "gps.csv" else (name,))
        (missing if here is None else found).append(
            f"{name}: {use}. Columns: {example[0]}  e.g. {example[1]}" if here is None else here.name
        )
    maps = maps_beside(path)
    others = [file for file in sorted(path.iterdir()) if file.suffix.lower() in _MAPS]
    given = "" if maps else f" --map {others[0] if len(others) == 1 else 'MAP'}"
    absent = "map: give --map FILE" + (f"; here: {', '.join(file.name for file in others)}" if others else "")
    (found if maps else missing).append(f"map {next(iter(maps.values())).name}" if maps else absent)
    return FirstLook(tuple(found), tuple(missing), tuple(written), _next(path, written, masks, given))


def _other_calibrations(path: Path) -> str:
    """Calibrations under names that are not looked for: they hold the numbers, as a rule without the mounting."""
    readable = []
    for file in sorted(path.iterdir()):
        if file.suffix.lower() in _CALIBRATIONS and file.name != "classes.yaml":
            try:
                read_calibration(file)
            except SemlocError:
                continue
            readable.append(file.name)
    return f"; intrinsics are in {', '.join(readable)}" if readable else ""


def _ids(masks: Path) -> str:
    """The ids in the first and the last mask, for the class table."""
    files = _pictures(masks) or [file for folder in sorted(masks.iterdir()) for file in _pictures(folder)]
    try:
        ids = sorted({int(value) for file in files[:1] + files[-1:] for value in np.unique(read_picture(file))})
    except SemlocError:
        return ""
    return f" with ids {' '.join(map(str, ids))}" if 0 < len(ids) <= _MOST_IDS else ""


def _holds_ids(picture: np.ndarray) -> bool:
    return picture.ndim == 2 and len(np.unique(picture)) <= _MOST_IDS


def _calibration_line(path: Path, missing: list[str]) -> str:
    calibration = next(path / name for name in CALIBRATIONS if (path / name).is_file())
    try:
        rig = read_calibration(calibration)
        drive = open_drive(path)
        return f"calibration {calibration.name} of {', '.join(rig.names)}; {len(drive)} frames in all"
    except SemlocError as error:
        missing.append(f"something that fits: {error}")
        return f"calibration {calibration.name}"


def _next(path: Path, written: list[Path], masks: Path | None, road: str) -> str:
    if any(file.name == "calib.yaml" for file in written):
        return f"fill in {path / 'calib.yaml'}, then: semloc check-calib {path}{road} --out check"
    if masks is None:
        return f"semloc segment {path} --model NET.onnx --class-table cityscapes{road}"
    return f"semloc localize {path}{road} --masks {masks.name} --class-table {path / 'classes.yaml'} --frames ::10"


def _of_drive(path: Path) -> FirstLook:
    drive = open_drive(path)
    found = [f"{len(drive)} frames of {', '.join(drive.rig.names)}"]
    parts = {"satellite fixes": drive.gnss, "wheel odometry": drive.odometry, "inertial data": drive.imu}
    parts |= {"reference poses": drive.truth, "map": drive.map_path}
    parts |= {f"masks {', '.join(drive.mask_sources)}": drive.mask_sources or None}
    found += [name for name, part in parts.items() if part is not None]
    missing = [name.strip() for name, part in parts.items() if part is None]
    masks = drive.mask_sources[0] if drive.mask_sources else "classical"
    road = "" if drive.map_path is not None else " --map MAP"
    return FirstLook(tuple(found), tuple(missing), (), f"semloc localize {path}{road} --masks {masks} --frames ::10")


def _cameras(path: Path) -> dict[str, tuple[int, tuple[int, int] | None]]:
    """Cameras of the folder of images (or masks): number of pictures and their size."""
    top = next(path / name for name in (*_IMAGES, *_MASKS) if (path / name).is_dir())
    folders = sorted(place for place in top.iterdir() if place.is_dir()) or [top]
    found = {}
    for folder in folders:
        files = _pictures(folder)
        size = read_picture(files[0]).shape[1::-1] if files else None
        found["front" if folder == top else folder.name] = (len(files), size)
    return found


def _pictures(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES)


def _write(path: Path, text: str) -> tuple[Path, ...]:
    """Write a template where nothing is there yet."""
    if path.exists():
        return ()
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SemlocError(
            f"{path}: cannot be written ({error.strerror}); copy the folder to where you may write"
        ) from error
    return (path,)
