"""What is there of somebody's own data, what is missing, and what to do next (room: inputs; host).

In: a folder, bag or video. Out: FirstLook, and templates of what is missing beside it.
"""

from dataclasses import dataclass
from pathlib import Path

from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets import open_drive
from semloc_jax.datasets.beside import CALIBRATIONS, calibration_beside, maps_beside
from semloc_jax.datasets.drive import is_drive
from semloc_jax.datasets.folder import has_pictures
from semloc_jax.datasets.pictures import read_picture
from semloc_jax.datasets.templates import CLASSES, COLUMNS, calibration_template
from semloc_jax.errors import SemlocError
from semloc_jax.perception import preset_names

_IMAGES, _MASKS = ("images", "image", "rgb"), ("masks", "labels", "sem")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")


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
            return FirstLook((), (f"pictures: {error}",), (), f"semloc init {path}  (once images/ is there)")
    return _of_folder(path) if path.is_dir() else _of_file(path)


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
        missing.append("calibration: intrinsics and place of each camera")
        written += _write(path / "calib.yaml", calibration_template(list(cameras), [s for _, s in cameras.values()]))
    else:
        found.append(_calibration_line(path, missing))
    if masks is None:
        missing.append(
            "masks/: semloc segment makes them with a network; --masks classical finds road paint without one"
        )
    else:
        found.append(f"masks in {masks.name}/: --class-table {', '.join(preset_names())}, or your own classes.yaml")
        written += _write(path / "classes.yaml", CLASSES)
    for name, use in (
        ("times.csv", "time of each frame; else file names, else 10 Hz is assumed"),
        ("gps.csv", "where to start; else --prior FILE.tum, or --area X,Y,RADIUS for track"),
        ("wheel_odom.csv", "how the vehicle moves; else constant velocity between frames"),
        ("imu.csv", "turns between frames"),
    ):
        example = COLUMNS[name].split("\n")
        here = (path / name).is_file()
        (found if here else missing).append(
            name if here else f"{name}: {use}. Columns: {example[0]}  e.g. {example[1]}"
        )
    maps = maps_beside(path)
    (found if maps else missing).append(f"map {next(iter(maps.values())).name}" if maps else "map: give --map FILE")
    return FirstLook(tuple(found), tuple(missing), tuple(written), _next(path, written, masks, bool(maps)))


def _calibration_line(path: Path, missing: list[str]) -> str:
    calibration = next(path / name for name in CALIBRATIONS if (path / name).is_file())
    try:
        rig = read_calibration(calibration)
        drive = open_drive(path)
        return f"calibration {calibration.name} of {', '.join(rig.names)}; {len(drive)} frames in all"
    except SemlocError as error:
        missing.append(f"something that fits: {error}")
        return f"calibration {calibration.name}"


def _next(path: Path, written: list[Path], masks: Path | None, has_map: bool) -> str:
    road = "" if has_map else " --map MAP"
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
        files = sorted(file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES)
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
