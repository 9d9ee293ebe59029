"""What is there of somebody's own data, what is missing, and what to do next (room: inputs; host).

In: a folder, bag or video. Out: FirstLook, and templates of what is missing beside it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets import Drive, open_drive, overlap_report
from semloc_jax.datasets.base import IMAGE
from semloc_jax.datasets.beside import CALIBRATIONS, FIXES, calibration_beside, folder_file, maps_in, read_fixes
from semloc_jax.datasets.drive import is_drive
from semloc_jax.datasets.folder import are_times, has_pictures, kind_folders
from semloc_jax.datasets.pictures import read_picture
from semloc_jax.datasets.sensors import read_imu, read_wheel_odometry
from semloc_jax.datasets.templates import CLASSES, COLUMNS, calibration_template, unfilled
from semloc_jax.datasets.video import Video, is_video
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.own_folder import (
    camera_matrix,
    distortion,
    ids_in,
    logs_of_other_names,
    moves_of,
    pictures_in,
    unplaced_pictures,
)
from semloc_jax.maps.io.formats import MAP_SUFFIXES
from semloc_jax.perception import load_class_table, preset_names

_CALIBRATIONS = (".yaml", ".yml", ".xml")
_LOGS: tuple[tuple[str, str, Callable[[Path], Any]], ...] = (
    ("gps.csv", "where to start; else --prior FILE.tum, or --area X,Y,RADIUS for track", read_fixes),
    ("wheel_odom.csv", "how the vehicle moves; else constant velocity between frames", read_wheel_odometry),
    ("imu.csv", "turns between frames", read_imu),
)
"""Logs that may be missing: name, what they are for, what reads them."""


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
    if path.is_file():
        return _of_file(path)
    if is_drive(path) or not has_pictures(path):
        try:
            return _of_drive(path)  # a data set with a layout of its own
        except SemlocError as error:
            return _without_pictures(path, error)
    kinds, others = kind_folders(path), unplaced_pictures(path)
    has_masks = any(kind != IMAGE for kind in kinds)
    lacking = [folder for folder in others if (not has_masks if folder.holds_ids else IMAGE not in kinds)]
    return _to_be_moved(path, lacking) if lacking and moves_of(path, lacking) else _of_folder(path)


def _without_pictures(path: Path, error: SemlocError) -> FirstLook:
    """A folder without images/: its pictures may lie in folders of other names, or in the folder itself."""
    folders, loose = unplaced_pictures(path), pictures_in(path)
    if folders:
        return _to_be_moved(path, folders)
    if len(loose) > 1:  # one alone is somebody's sketch
        endings = " ".join(sorted({f"{path}/*{file.suffix}" for file in loose}))
        moves = f"mkdir {path / 'images'}; mv {endings} {path / 'images'}/; semloc init {path}"
        return FirstLook((f"{len(loose)} pictures in {path} itself",), (_PLACES,), (), moves)
    if not any(path.iterdir()):
        error = SemlocError(f"{path} is empty; expected images/ with a folder of png or jpg files for each camera")
    is_plain = not any(path.iterdir()) or str(error).startswith("folder ")
    first = f"put pictures into {path / 'images'}/" if is_plain else "mend that"
    return FirstLook((), (f"pictures: {error}",), (), f"{first}, then: semloc init {path}")


_PLACES = "images/: photographs are looked for in images/, masks in masks/ (with a folder for each camera in them)"


def _to_be_moved(path: Path, folders: list) -> FirstLook:
    """Pictures under names that are not looked for."""
    moves = moves_of(path, folders) or [f"mkdir {path / 'images'}, move a folder for each camera there"]
    there = [f"{folder.name}/" for folder in kind_folders(path).values()]
    return FirstLook((*there, *map(str, folders)), (_PLACES,), (), "; ".join([*moves, f"semloc init {path}"]))


def _of_file(path: Path) -> FirstLook:
    """A bag or a video: its calibration may have to lie beside it."""
    calibration = calibration_beside(path)
    try:
        return _of_drive(path)
    except SemlocError as error:
        size_px = Video(path).picture(0).shape[1::-1] if is_video(path) else None
        written = () if calibration else _write(path.parent / "calib.yaml", calibration_template(["front"], [size_px]))
        calibration = calibration or path.parent / "calib.yaml"
        words = unfilled(calibration.read_text(encoding="utf-8", errors="replace")) if calibration.is_file() else []
        why = f"calibration: {', '.join(words)} in {calibration} are not filled in" if words else str(error)
        first = (
            f"fill in {calibration}, then: semloc check-calib {path} --out check" if words else f"semloc init {path}"
        )
        return FirstLook((f"{path.name}",), (why,), written, first)


def _of_folder(path: Path) -> FirstLook:
    """A folder of pictures: every part is looked at by itself, so that one that is wrong hides no other."""
    found, missing, written = [], [], []
    cameras, kinds = _cameras(path), kind_folders(path)
    masks = next((folder for kind, folder in kinds.items() if kind != IMAGE), None)
    for name, (count, size) in cameras.items():
        what = "pictures" if IMAGE in kinds else "masks"
        found.append(f"camera {name}: {count} {what}" + (f" of {size[0]}x{size[1]} px" if size else ""))
    opens = _look_at_calibration(path, cameras, found, missing, written)
    if masks is None:
        missing.append(
            "masks/: semloc segment makes them with a network; --masks net finds paint and posts without one"
        )
    else:
        found.append(f"masks in {masks.name}/{_tables_of(ids_in(masks))}, or your own classes.yaml")
        written += _write(path / "classes.yaml", CLASSES)
    _look_at_times(path, found, missing)
    _look_at_logs(path, found, missing)
    own = next(iter(maps_in(path).values()), None)
    near = [place for folder in (path, path.parent) for place in _maps_of(folder)]
    near = [place for place in near if place.parent == near[0].parent]
    given = "" if own else f" --map {near[0] if len(near) == 1 else 'MAP'}"
    absent = "map: give --map FILE" + (f"; there: {', '.join(map(str, near))}" if near else "")
    (found if own else missing).append(f"map {own.name}" if own else absent)
    return FirstLook(tuple(found), tuple(missing), tuple(written), _next(path, opens, masks, given))


def _look_at_calibration(path: Path, cameras: dict, found: list, missing: list, written: list) -> bool:
    """Say what is known of the cameras; whether the folder opens as a drive."""
    calibration = folder_file(path, CALIBRATIONS)
    if calibration is None:
        matrix, lens = (camera_matrix(path), distortion(path)) if len(cameras) == 1 else (None, None)
        found += [f"{part[0]}: its numbers are in calib.yaml" for part in (matrix, lens) if part]
        missing.append("calibration: intrinsics and place of each camera" + _other_calibrations(path))
        sizes = [size for _, size in cameras.values()]
        numbers = ([] if part is None else part[1] for part in (matrix, lens))
        written += _write(path / "calib.yaml", calibration_template(list(cameras), sizes, *numbers))
        return False
    words = unfilled(calibration.read_text(encoding="utf-8", errors="replace"))
    if words:
        missing.append(f"calibration: {', '.join(words)} in {calibration.name} are not filled in")
        return False
    try:
        rig = read_calibration(calibration)
        drive = open_drive(path)
    except SemlocError as error:
        missing.append(f"what fits together: {error}")
        return False
    found.append(f"calibration {calibration.name} of {', '.join(rig.names)}; {len(drive)} frames in all")
    missing += _other_clocks(drive)
    return True


def _look_at_times(path: Path, found: list, missing: list) -> None:
    """Where the times of the frames come from."""
    top = next(iter(kind_folders(path).values()))
    folders = [top, *(place for place in sorted(top.iterdir()) if place.is_dir())]
    stems = next(([file.stem for file in files] for folder in folders if (files := pictures_in(folder))), [])
    file = folder_file(path, ("times.csv", "timestamps.txt"))
    if file is not None or are_times(stems):
        found.append("times of the frames: " + (file.name if file else f"names of the files, {stems[0]} ..."))
        return
    header, example = COLUMNS["times.csv"].split("\n")[:2]
    missing.append(f"times.csv: time of each frame; else 10 Hz is assumed. Columns: {header}  e.g. {example}")


def _look_at_logs(path: Path, found: list, missing: list) -> None:
    """Which logs are there and can be read, which have another name, and which are missing."""
    others = logs_of_other_names(path)
    for name, use, read in _LOGS:
        header, example = COLUMNS[name].split("\n")[:2]
        here = folder_file(path, FIXES if name == "gps.csv" else (name,))
        if here is None:
            own, columns = others.get(name), f"Columns: {header}  e.g. {example}"
            renamed = f"{own} has its columns: mv {path / own} {path / name}" if own else ""
            missing.append(f"{name}: {renamed or f'{use}. {columns}'}")
            continue
        try:
            found.append(f"{here.name}: {len(read(here).time_s)} rows")
        except SemlocError as error:
            missing.append(f"{name}: {error}  e.g. {example}")


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


def _maps_of(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in MAP_SUFFIXES and file.is_file())


def _tables_of(ids: list[int]) -> str:
    """The ids of masks and the class tables that know all of them."""
    fit = [name for name in preset_names() if set(ids) <= {0, 255, *load_class_table(name).id_names}]
    if not ids:
        return f": --class-table {', '.join(preset_names())}"
    return f" with ids {' '.join(map(str, ids))}" + (f": --class-table {', '.join(fit)}" if fit else ": no preset fits")


def _next(path: Path, opens: bool, masks: Path | None, road: str) -> str:
    calibration = folder_file(path, CALIBRATIONS)
    if calibration is not None and unfilled(calibration.read_text(encoding="utf-8", errors="replace")):
        drawn = "" if road.endswith(" MAP") else road
        return f"fill in {calibration}, then: semloc check-calib {path}{drawn} --out check"
    if not opens:
        return f"mend what is said under 'missing', then: semloc init {path}"
    if masks is None:
        return f"semloc segment {path} --model NET.onnx --class-table cityscapes{road}"
    table = path / "classes.yaml"
    first = f"fill in {table} (or take a preset), then: " if unfilled(table.read_text(encoding="utf-8")) else ""
    return f"{first}semloc localize {path}{road} --masks {masks.name} --class-table {table} --frames ::10"


def _of_drive(path: Path) -> FirstLook:
    drive = open_drive(path)
    found = [f"{len(drive)} frames of {', '.join(drive.rig.names)}"]
    parts = {"satellite fixes": drive.gnss, "wheel odometry": drive.odometry, "inertial data": drive.imu}
    parts |= {"reference poses": drive.truth, "map": drive.map_path}
    parts |= {f"masks {', '.join(drive.mask_sources)}": drive.mask_sources or None}
    found += [name for name, part in parts.items() if part is not None]
    missing = [name.strip() for name, part in parts.items() if part is None]
    missing += _other_clocks(drive)
    masks = drive.mask_sources[0] if drive.mask_sources else "classical"
    road = "" if drive.map_path is not None else " --map MAP"
    if drive.mask_sources and not drive.table_name:
        masks += " --class-table TABLE"
        ids = {int(value) for mask in _masks_of(drive) for value in np.unique(mask)}
        missing.append(f"class table of the masks{_tables_of(sorted(ids))}, or your own YAML file")
    return FirstLook(tuple(found), tuple(missing), (), f"semloc localize {path}{road} --masks {masks} --frames ::10")


def _masks_of(drive: Drive) -> list[np.ndarray]:
    """Some masks of a drive: of all cameras that have them, in its first and its last frame."""
    source = drive.mask_sources[0]
    looks = [(frame, camera) for frame in (drive.frames[0], drive.frames[-1]) for camera in drive.rig.names]
    return [frame.mask(source, camera) for frame, camera in looks if frame.has(source, camera)]


def _other_clocks(drive: Drive) -> list[str]:
    """Streams that have no time in common with the frames."""
    report = overlap_report(drive)
    apart = tuple(f"{span.name} " for span in report.spans if report.apart(span.name))
    return [f"common time: {problem}" for problem in report.problems if apart and problem.startswith(apart)]


def _cameras(path: Path) -> dict[str, tuple[int, tuple[int, int] | None]]:
    """Cameras of the folder of images (or masks): number of pictures and their size."""
    top = next(iter(kind_folders(path).values()))
    folders = sorted(place for place in top.iterdir() if place.is_dir()) or [top]
    found = {}
    for folder in folders:
        files = pictures_in(folder)
        size = read_picture(files[0]).shape[1::-1] if files else None
        found["front" if folder == top else folder.name] = (len(files), size)
    return found


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
