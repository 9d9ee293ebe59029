"""A plain folder of images and masks with a calibration (room: datasets; host).

In: images/ (or rgb/) and masks/, each with one folder per camera or, for one camera, the files themselves;
calib.yaml or any calibration the cameras room reads; optionally times.csv, poses.tum and a map. Out: Sequence.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from semloc_jax.cameras import Rig, read_calibration
from semloc_jax.datasets.base import IMAGE, Frame, Sequence
from semloc_jax.datasets.tables import read_rows
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory, read_trajectory

_KIND_OF_FOLDER = {"images": IMAGE, "image": IMAGE, "rgb": IMAGE, "masks": "masks", "labels": "masks", "sem": "sem"}
_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
_CALIBRATIONS = ("calib.yaml", "camchain.yaml", "calibration.yaml", "camera_info.yaml", "calib.xml")
_POSES = ("poses_body.tum", "poses.tum", "poses.txt", "poses.npy")
_MAPS = ("map.geojson", "map.osm", "map.gpkg", "map.xodr")


def read_folder(
    path: str | Path, calibration: str | Path | None = None, table_name: str = "", rate_hz: float = 10.0
) -> Sequence:
    """Sequence of a folder of files.

    Files of different kinds and cameras belong together by their stem. Times come from `times.csv` (columns frame, t)
    or, where there are as many poses as frames, from the poses; else frames follow each other at `rate_hz`.

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
    by_kind = {kind: _files_of(folder, rig) for folder, kind in _kind_folders(path)}
    if not by_kind:
        raise SemlocError(f"folder {path}: no images; expected a folder images/ or masks/ with png or jpg files")
    stems = sorted(set.intersection(*(set(files[camera]) for files in by_kind.values() for camera in rig.names)))
    if not stems:
        raise SemlocError(f"folder {path}: no file name is shared by all of {', '.join(by_kind)} and all cameras")
    truth = next((read_trajectory(path / name) for name in _POSES if (path / name).is_file()), None)
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
    return Sequence(
        name=path.resolve().name,
        path=path,
        frames=frames,
        rig=rig,
        table_name=table_name,
        mask_sources=tuple(kind for kind in by_kind if kind != IMAGE),
        maps={name.split(".")[1]: path / name for name in _MAPS if (path / name).is_file()},
        truth=truth,
    )


def has_pictures(path: Path) -> bool:
    """Whether a folder has a folder of images or masks."""
    return bool(_kind_folders(path))


def _find_calibration(path: Path) -> Path:
    for name in _CALIBRATIONS:
        if (path / name).is_file():
            return path / name
    raise SemlocError(f"folder {path}: no calibration; expected one of {', '.join(_CALIBRATIONS)}; or name one")


def _kind_folders(path: Path) -> list[tuple[Path, str]]:
    return [(path / name, kind) for name, kind in _KIND_OF_FOLDER.items() if (path / name).is_dir()]


def _files_of(folder: Path, rig: Rig) -> Mapping[str, Mapping[str, Path]]:
    """Files by camera and stem; a folder without camera folders belongs to the only camera of the rig."""
    if len(rig) == 1 and not (folder / rig.names[0]).is_dir():
        return {rig.names[0]: _pictures(folder)}
    missing = [camera for camera in rig.names if not (folder / camera).is_dir()]
    if missing:
        raise SemlocError(
            f"folder {folder}: no folder for camera {', '.join(missing)}; expected one for each camera of the "
            f"calibration: {', '.join(rig.names)}"
        )
    return {camera: _pictures(folder / camera) for camera in rig.names}


def _pictures(folder: Path) -> dict[str, Path]:
    return {file.stem: file for file in sorted(folder.iterdir()) if file.suffix.lower() in _SUFFIXES}


def _frame_times(path: Path, stems: list[str], truth: Trajectory | None, rate_hz: float) -> np.ndarray:
    if (path / "times.csv").is_file():
        time_of = {row["frame"]: float(row["t"]) for row in read_rows(path / "times.csv", ("frame", "t"))}
        absent = [stem for stem in stems if stem not in time_of]
        if absent:
            raise SemlocError(f"folder {path}: times.csv has no row for frame {absent[0]}; expected one for each frame")
        return np.array([time_of[stem] for stem in stems])
    if truth is not None and len(truth) == len(stems) and np.ptp(truth.time_s) != len(stems) - 1:
        return truth.time_s
    return np.arange(len(stems)) / rate_hz
