"""KITTI sequences, odometry and raw (room: datasets; host).

In: image_0 ... image_3 with calib.txt and times.txt (odometry), or image_00 ... image_03/data with timestamps.txt,
oxts/ and calib_cam_to_cam.txt in the folder or above it (raw). Out: Drive.
"""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.cameras.io.kitti import rig_from_kitti
from semloc_jax.datasets.base import IMAGE, Drive
from semloc_jax.datasets.beside import maps_beside
from semloc_jax.datasets.in_step import PictureStream, frames_in_step
from semloc_jax.datasets.pictures import read_picture
from semloc_jax.datasets.sensors import GnssTrack, Imu, WheelOdometry
from semloc_jax.datasets.tables import read_numbers
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory, read_trajectory

_ODOMETRY, _RAW = ("image_2", "image_3", "image_0", "image_1"), ("image_02", "image_03", "image_00", "image_01")
"""Colour cameras first."""
_OXTS_SIGMA_M = (0.5, 0.5, 1.0)
"""The OXTS works with RTK where it can; our choice."""
_ANTENNA_BASE = (0.05, 0.0, 0.93)
"""The OXTS box, to which its fixes refer: from the published drawing of the car."""


def is_kitti(path: Path) -> bool:
    """Whether a folder is a sequence of KITTI."""
    odometry = (path / "calib.txt").is_file() and any((path / name).is_dir() for name in _ODOMETRY)
    return odometry or any(
        (path / name / "data").is_dir() and (path / name / "timestamps.txt").is_file() for name in _RAW
    )


def read_kitti(path: str | Path, calibration: str | Path | None = None) -> Drive:
    """Drive of a folder of the odometry benchmark (00 ... 21) or a raw drive (..._sync).

    The truth of the odometry benchmark (poses.txt in the folder) is that of the base in the frame of its first pose.

    Raises:
        SemlocError: files are missing or are not what KITTI writes.
    """
    path = Path(path)
    is_raw = any((path / name / "data").is_dir() for name in _RAW)
    names = [name for name in (_RAW if is_raw else _ODOMETRY) if (path / name).is_dir()]
    streams = {name: _pictures(path, name, is_raw) for name in names}
    calibrated = read_calibration(calibration) if calibration is not None else _rig(path, streams, is_raw)
    rig = calibrated.select([name for name in names if name in calibrated.names] or list(calibrated.names))
    gnss, odometry, imu = _oxts(path / "oxts") if (path / "oxts" / "data").is_dir() else (None, None, None)
    rig, frames = frames_in_step({IMAGE: streams}, rig, odometry, f"KITTI {path}")
    times = streams[names[0]].time_s
    return Drive(
        name=path.resolve().name,
        path=path,
        frames=frames,
        rig=rig,
        maps=maps_beside(path),
        truth=_truth(path, times, calibrated),
        gnss=gnss,
        odometry=odometry,
        imu=imu,
    )


def _pictures(path: Path, camera: str, is_raw: bool) -> PictureStream:
    folder = path / camera / "data" if is_raw else path / camera
    files = tuple(sorted(file for file in folder.iterdir() if file.suffix in (".png", ".jpg")))
    time_s = _times(path / camera / "timestamps.txt") if is_raw else read_numbers(path / "times.txt", 1)[:, 0]
    if not files or len(time_s) < len(files):
        raise SemlocError(f"KITTI {folder}: {len(files)} pictures and {len(time_s)} times; expected a time for each")
    # Raw drives may lack pictures: files are named by the row of their time.
    rows = [int(file.stem) if file.stem.isdigit() and int(file.stem) < len(time_s) else -1 for file in files]
    if min(rows) < 0:
        raise SemlocError(f"KITTI {folder}: {files[rows.index(min(rows))].name}; expected names such as 0000000000.png")
    return PictureStream(time_s[rows], files, tuple(file.stem for file in files))


def _rig(path: Path, streams: dict[str, PictureStream], is_raw: bool) -> Rig:
    if not is_raw:
        height, width = read_picture(next(iter(streams.values())).pictures[0]).shape[:2]
        return rig_from_kitti(path / "calib.txt", (width, height))
    for place in (path, path.parent):
        if (place / "calib_cam_to_cam.txt").is_file():
            return rig_from_kitti(place / "calib_cam_to_cam.txt")
    raise SemlocError(f"KITTI {path}: no calib_cam_to_cam.txt in it or above it; download the calibration of the day")


def _truth(path: Path, time_s: np.ndarray, rig: Rig) -> Trajectory | None:
    """Poses of the base: KITTI's are those of camera 0, z forward, in the frame of the first of them."""
    if not (path / "poses.txt").is_file():
        return None
    poses = read_trajectory(path / "poses.txt").T_map_base
    if len(poses) != len(time_s):
        raise SemlocError(f"KITTI {path}: poses.txt has {len(poses)} poses for {len(time_s)} times; expected one each")
    T_base_cam0 = np.asarray(rig.T_base_cam[rig.index("image_0")] if "image_0" in rig.names else rig.T_base_cam[0])
    return Trajectory(time_s, T_base_cam0 @ poses @ np.linalg.inv(T_base_cam0))


def _oxts(folder: Path) -> tuple[GnssTrack, WheelOdometry | None, Imu]:
    """Fixes, forward speed and yaw rate, inertial data of the OXTS rows."""
    files = sorted((folder / "data").glob("*.txt"))
    time_s = _times(folder / "timestamps.txt")
    if not files or len(files) > len(time_s):
        raise SemlocError(f"KITTI {folder}: {len(files)} rows and {len(time_s)} times; expected a time for each")
    rows = np.concatenate([read_numbers(file, None)[:1] for file in files])
    if rows.shape[1] < 25:
        raise SemlocError(f"KITTI {folder}: rows of {rows.shape[1]} numbers; expected 30 as in dataformat.txt")
    time_s, keep = np.unique(time_s[: len(rows)], return_index=True)
    rows = rows[keep]
    gnss = GnssTrack.from_wgs84(time_s, rows[:, :3], np.tile(_OXTS_SIGMA_M, (len(rows), 1)), _ANTENNA_BASE)
    odometry = WheelOdometry(time_s, rows[:, 8].copy(), rows[:, 19].copy()) if len(rows) > 1 else None
    return gnss, odometry, Imu(time_s, rows[:, 17:20].copy(), rows[:, 11:14].copy())


def _times(path: Path) -> np.ndarray:
    """Seconds since 1970 of lines such as 2011-09-26 13:02:25.964389445."""
    if not path.is_file():
        raise SemlocError(f"KITTI {path}: no such file; expected a date and time for each picture")
    found = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
        if not line.strip():
            continue
        whole, _, fraction = line.strip().partition(".")
        try:
            start = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
            found.append(start + (float(f"0.{fraction}") if fraction else 0.0))
        except ValueError as error:
            raise SemlocError(f"KITTI {path} line {number}: {error}; expected 2011-09-26 13:02:25.964389445") from error
    return np.array(found)
