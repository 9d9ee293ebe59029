"""Scenes of nuScenes and of data sets in its layout (room: datasets; host).

In: a folder with v1.0-... tables and samples/ (sweeps/). Out: Drive of one scene, in the frame of its map.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.cameras.io import read_calibration
from semloc_jax.cameras.io.fields import resolution
from semloc_jax.cameras.io.nuscenes import nuscenes_tables, pose_of, read_rows, rig_of_rows
from semloc_jax.datasets.base import IMAGE, Drive
from semloc_jax.datasets.beside import maps_beside
from semloc_jax.datasets.clock import seconds
from semloc_jax.datasets.in_step import PictureStream, frames_in_step, odometry_from_poses
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory

_CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")

Row = Mapping[str, Any]


def is_nuscenes(path: Path) -> bool:
    """Whether a folder holds tables of nuScenes."""
    folder = nuscenes_tables(path)
    return folder is not None and (folder / "sample_data.json").is_file()


def read_nuscenes(path: str | Path, calibration: str | Path | None = None, scene: str | None = None) -> Drive:
    """Drive of one scene: key frames of the cameras, ego poses as truth, their motion as odometry.

    Args:
        path: folder with the tables and samples/.
        calibration: calibration file instead of the tables.
        scene: name of the scene, e.g. scene-0061; None for the first.

    Raises:
        SemlocError: tables are missing or do not refer to each other as they should.
    """
    path = Path(path)
    folder = nuscenes_tables(path)
    if folder is None:
        raise SemlocError(f"nuScenes {path}: no tables; expected a folder with v1.0-mini or the like")
    root = path if folder != path else path.parent
    scenes = read_rows(folder / "scene.json")
    chosen = next((row for row in scenes if scene in (None, row.get("name"))), None)
    if chosen is None:
        names = ", ".join(str(row.get("name")) for row in scenes[:8])
        raise SemlocError(f"nuScenes {folder}: no scene '{scene}'; expected one of {names}")
    data, mounted = _camera_data(folder, str(chosen.get("token")))
    if not data:
        raise SemlocError(f"nuScenes {folder}: scene {chosen.get('name')} has no camera pictures in sample_data.json")
    order = sorted(data, key=lambda name: _CAMERAS.index(name) if name in _CAMERAS else len(_CAMERAS))
    first = data[order[0]][0]
    where = f"nuScenes {path}"
    width, height = resolution([first.get("width") or 1600, first.get("height") or 900], f"{where}: size").tolist()
    rig = (
        read_calibration(calibration)
        if calibration
        else rig_of_rows({n: mounted[n] for n in order}, where, (int(width), int(height)))
    )
    truth = _ego_poses(folder, [row for rows in data.values() for row in rows])
    streams = {name: _stream(root, rows, where) for name, rows in data.items()}
    odometry = odometry_from_poses(truth)
    rig, frames = frames_in_step({IMAGE: streams}, rig, odometry, where)
    return Drive(
        name=str(chosen.get("name")),
        path=path,
        frames=frames,
        rig=rig,
        maps=maps_beside(path),
        truth=truth,
        odometry=odometry,
    )


def _camera_data(folder: Path, scene: str) -> tuple[dict[str, list[Row]], dict[str, Row]]:
    """Key frames of each camera of a scene, and how it is mounted."""
    samples = {str(row.get("token")) for row in read_rows(folder / "sample.json") if row.get("scene_token") == scene}
    sensors = {str(row.get("token")): row for row in read_rows(folder / "sensor.json")}
    mounts = {str(row.get("token")): row for row in read_rows(folder / "calibrated_sensor.json")}
    data: dict[str, list[Row]] = {}
    mounted: dict[str, Row] = {}
    for row in read_rows(folder / "sample_data.json"):
        mount = mounts.get(str(row.get("calibrated_sensor_token")))
        sensor = sensors.get(str(mount.get("sensor_token")), {}) if mount else {}
        if (
            sensor.get("modality") != "camera"
            or str(row.get("sample_token")) not in samples
            or not row.get("is_key_frame")
        ):
            continue
        channel = str(sensor.get("channel"))
        data.setdefault(channel, []).append(row)
        mounted.setdefault(channel, mount)
    return data, mounted


def _ego_poses(folder: Path, rows: list[Row]) -> Trajectory:
    wanted = {str(row.get("ego_pose_token")) for row in rows}
    poses = [row for row in read_rows(folder / "ego_pose.json") if str(row.get("token")) in wanted]
    if not poses:
        raise SemlocError(f"nuScenes {folder}: ego_pose.json has none of the poses of the pictures")
    time_s = _times(poses, f"nuScenes {folder}/ego_pose.json")
    time_s, keep = np.unique(time_s, return_index=True)
    T = np.stack([pose_of(poses[i], f"nuScenes {folder}/ego_pose.json") for i in keep])
    return Trajectory(time_s, T)


def _stream(root: Path, rows: list[Row], where: str) -> PictureStream:
    files = []
    for row in rows:
        name = str(row.get("filename"))
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise SemlocError(f"{where}: file name '{name}' leaves the data set; expected samples/CAM_FRONT/...")
        files.append(root / name)
    return PictureStream(_times(rows, where), tuple(files), tuple(str(row.get("sample_token"))[:12] for row in rows))


def _times(rows: list[Row], where: str) -> np.ndarray:
    try:
        stamps = np.array([int(row["timestamp"]) for row in rows], dtype=np.int64)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SemlocError(f"{where}: timestamp {error!r}; expected whole microseconds") from error
    return seconds(stamps, where, "timestamp_us")[0]
