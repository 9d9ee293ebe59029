"""nuScenes calibrations (room: cameras; host).

In: sensor.json, calibrated_sensor.json and, where there, sample_data.json of a table folder such as v1.0-mini.
Out: Rig; the vehicle frame of nuScenes is the middle of the rear axle on the ground, as ours.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from semloc_jax.cameras.io.fields import check_focal, intrinsics_of, numbers, read_text, required
from semloc_jax.cameras.pinhole import PinholeCamera
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.rigid import pose_from

RESOLUTION = (1600, 900)
"""Size of every image of the data set."""

Row = Mapping[str, Any]


def nuscenes_tables(path: Path) -> Path | None:
    """The folder with the tables: `path` itself, or the first v1.0-... in it; None for anything else."""
    for place in (path, *sorted(path.glob("v1.0-*"))) if path.is_dir() else ():
        if (place / "calibrated_sensor.json").is_file() and (place / "sensor.json").is_file():
            return place
    return None


def rig_from_nuscenes(path: Path) -> Rig:
    """The cameras of the first vehicle of the tables."""
    folder = nuscenes_tables(path)
    if folder is None:
        raise SemlocError(f"calibration {path}: no calibrated_sensor.json; expected a folder such as v1.0-mini")
    channels = {str(row.get("token")): row for row in read_rows(folder / "sensor.json")}
    first: dict[str, Row] = {}
    for row in read_rows(folder / "calibrated_sensor.json"):
        channel = channels.get(str(row.get("sensor_token")), {})
        if channel.get("modality") == "camera":
            first.setdefault(str(channel.get("channel")), row)
    if not first:
        raise SemlocError(f"calibration {folder}: no sensor is a camera; expected modality 'camera' in sensor.json")
    return rig_of_rows(first, f"calibration {folder}")


def rig_of_rows(rows: Mapping[str, Row], where: str, size_px: tuple[int, int] = RESOLUTION) -> Rig:
    """The cameras of rows of calibrated_sensor by their channel."""
    cameras, poses = [], []
    for name, row in rows.items():
        place = f"{where}: {name}"
        K = numbers(required(row, "camera_intrinsic", place), (9,), f"{place} camera_intrinsic")
        intrinsics = intrinsics_of(K, place)
        check_focal(intrinsics[0], intrinsics[1], place)
        cameras.append(PinholeCamera(*intrinsics, *size_px))
        poses.append(pose_of(row, place))
    return Rig(cameras, np.stack(poses), list(rows))


def pose_of(row: Row, where: str) -> np.ndarray:
    """Rigid motion [4 4] of `rotation` (w x y z) and `translation`."""
    quaternion = numbers(required(row, "rotation", where), (4,), f"{where} rotation")
    if np.linalg.norm(quaternion) < 1e-6:
        raise SemlocError(f"{where}: rotation {quaternion.tolist()}; expected a unit quaternion w x y z")
    return pose_from(
        Rotation.from_quat(quaternion[[1, 2, 3, 0]]).as_matrix(),
        numbers(required(row, "translation", where), (3,), f"{where} translation"),
    )


def read_rows(path: Path) -> Sequence[Row]:
    """Rows of a table.

    Raises:
        SemlocError: the file is missing or no list of objects.
    """
    if not path.is_file():
        raise SemlocError(f"nuScenes {path}: no such file; expected the tables of one version, e.g. v1.0-mini")
    try:
        rows = json.loads(read_text(path))
    except (json.JSONDecodeError, RecursionError) as error:
        raise SemlocError(f"nuScenes {path}: not valid JSON ({error}); is the file complete?") from error
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise SemlocError(f"nuScenes {path}: holds {type(rows).__name__}; expected a list of rows")
    return rows
