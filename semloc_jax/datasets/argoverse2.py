"""Logs of the Argoverse 2 sensor data set (room: datasets; host).

In: calibration/, city_SE3_egovehicle.feather, sensors/cameras/NAME/TIMESTAMP_NS.jpg. Out: Drive in the city frame.
The base is the vehicle frame of the data set, lowered from the rear axle to the road.
"""

from pathlib import Path

import numpy as np

from semloc_jax.cameras.io import read_calibration
from semloc_jax.cameras.io.argoverse2 import AXLE_HEIGHT_M, is_argoverse2, pose_of_row, read_feather
from semloc_jax.datasets.base import IMAGE, Drive
from semloc_jax.datasets.beside import maps_beside
from semloc_jax.datasets.clock import seconds
from semloc_jax.datasets.in_step import PictureStream, frames_in_step, odometry_from_poses
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory

_POSES = "city_SE3_egovehicle.feather"


def is_argoverse2_log(path: Path) -> bool:
    """Whether a folder is one log of the sensor data set."""
    return path.is_dir() and is_argoverse2(path) and (path / _POSES).is_file()


def read_argoverse2(path: str | Path, calibration: str | Path | None = None) -> Drive:
    """Drive of a log; its poses are the truth, and their motion takes the place of odometry.

    Raises:
        SemlocError: pyarrow is missing, or files are missing or damaged.
    """
    path = Path(path)
    rig = read_calibration(calibration if calibration is not None else path)
    truth = ego_poses(path)
    folder = path / "sensors" / "cameras"
    streams = {name: _pictures(folder / name) for name in rig.names if (folder / name).is_dir()}
    odometry = odometry_from_poses(truth)
    rig, frames = frames_in_step({IMAGE: streams}, rig, odometry, f"Argoverse 2 {path}")
    own_map = next(iter(sorted((path / "map").glob("log_map_archive_*.json"))), None)
    maps = {} if own_map is None else {"argoverse2": own_map}
    return Drive(
        name=path.resolve().name,
        path=path,
        frames=frames,
        rig=rig,
        maps=maps | maps_beside(path),
        truth=truth,
        odometry=odometry,
    )


def ego_poses(path: Path) -> Trajectory:
    """Poses of the base of a log in the frame of the city.

    Raises:
        SemlocError: the table lacks a column or holds no rigid motion.
    """
    table = read_feather(path / _POSES)
    missing = {"timestamp_ns", "qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"} - set(table)
    if missing:
        raise SemlocError(f"{path / _POSES}: lacks {', '.join(sorted(missing))}; expected the poses of a log")
    time_s, _ = seconds(np.array(table["timestamp_ns"], dtype=np.int64), f"{path / _POSES}", "timestamp_ns")
    time_s, keep = np.unique(time_s, return_index=True)
    # A city is kilometres wide: the check of a calibration on 50 m does not apply.
    origin = {key: [0.0] * len(table[key]) for key in ("tx_m", "ty_m", "tz_m")}
    T = np.stack([pose_of_row(table | origin, int(row), f"{path / _POSES}") for row in keep])
    T[:, :3, 3] = np.array([table[key] for key in ("tx_m", "ty_m", "tz_m")], dtype=np.float64).T[keep]
    T[:, :3, 3] -= AXLE_HEIGHT_M * T[:, :3, 2]
    return Trajectory(time_s, T)


def _pictures(folder: Path) -> PictureStream:
    files = sorted(file for file in folder.iterdir() if file.suffix in (".jpg", ".png") and file.stem.isdigit())
    stamps = np.array([int(file.stem) for file in files], dtype=np.int64)
    time_s, _ = seconds(stamps, f"Argoverse 2 {folder}", "timestamp_ns")
    return PictureStream(time_s, tuple(files), tuple(file.stem for file in files))
