"""EuRoC / ASL folders (room: datasets; host).

In: [mav0/]cam0, cam1 ... each with sensor.yaml, data.csv, data/; imu0/data.csv; state_groundtruth_estimate0/data.csv.
Out: Drive. The body of the format (its IMU) is used as the base.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.cameras.io.fields import load_yaml, numbers, perspective, required, resolution, rigid
from semloc_jax.datasets.base import IMAGE, Drive
from semloc_jax.datasets.beside import maps_beside
from semloc_jax.datasets.clock import seconds
from semloc_jax.datasets.in_step import PictureStream, frames_in_step
from semloc_jax.datasets.inertial import imu_noise_in
from semloc_jax.datasets.sensors import Imu
from semloc_jax.datasets.tables import read_cells
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.geometry.rigid import pose_from
from semloc_jax.structs import InertialNoise

_TRUTH = ("state_groundtruth_estimate0", "mocap0", "vicon0", "leica0", "groundtruth")


def is_euroc(path: Path) -> bool:
    """Whether a folder is laid out as EuRoC's."""
    root = _root(path)
    return any((root / name / "data.csv").is_file() for name in ("cam0", "cam1"))


def read_euroc(path: str | Path, calibration: str | Path | None = None) -> Drive:
    """Drive of a folder in the ASL layout.

    Its poses are those of the body in sensor.yaml, an IMU: give --calib with T_base_cam where the ground matters.

    Raises:
        SemlocError: files are missing or are not what the layout says.
    """
    path = Path(path)
    root = _root(path)
    cameras = sorted(folder.name for folder in root.glob("cam*") if (folder / "data.csv").is_file())
    streams = {name: _pictures(root / name) for name in cameras}
    rig = read_calibration(calibration) if calibration is not None else _rig(root, cameras)
    rig, frames = frames_in_step({IMAGE: streams}, rig, None, f"EuRoC {path}")
    return Drive(
        name=path.resolve().name,
        path=path,
        frames=frames,
        rig=rig,
        maps=maps_beside(path),
        truth=next((_truth(root / name / "data.csv") for name in _TRUTH if (root / name / "data.csv").is_file()), None),
        imu=_imu(root / "imu0") if (root / "imu0" / "data.csv").is_file() else None,
    )


def _root(path: Path) -> Path:
    return path / "mav0" if (path / "mav0").is_dir() else path


def _pictures(folder: Path) -> PictureStream:
    rows = read_cells(folder / "data.csv", 1)
    time_s, _ = seconds(np.array([_whole(row[0], folder) for row in rows], dtype=np.int64), f"EuRoC {folder}", "t_ns")
    files = tuple(folder / "data" / (row[1].strip() if len(row) > 1 else f"{row[0].strip()}.png") for row in rows)
    return PictureStream(time_s, files, tuple(file.stem for file in files))


def _rig(root: Path, cameras: list[str]) -> Rig:
    models, poses = [], []
    for name in cameras:
        content, where = _sensor(root / name)
        size = resolution(required(content, "resolution", where), f"{where} resolution")
        intrinsics = numbers(required(content, "intrinsics", where), (4,), f"{where} intrinsics")
        model = str(content.get("distortion_model", "none")).replace("radial-tangential", "radtan")
        models.append(perspective(intrinsics, size, model, content.get("distortion_coefficients", []), where))
        poses.append(_body(content, where))
    return Rig(models, np.stack(poses), cameras)


def _sensor(folder: Path) -> tuple[Mapping[str, Any], str]:
    if not (folder / "sensor.yaml").is_file():
        raise SemlocError(f"EuRoC {folder}: no sensor.yaml; expected one for each sensor, or give --calib FILE")
    return load_yaml(folder / "sensor.yaml"), f"EuRoC {folder}/sensor.yaml"


def _body(content: Mapping[str, Any], where: str) -> np.ndarray:
    """T_BS: sensor to body."""
    T = required(content, "T_BS", where)
    return rigid(T.get("data") if isinstance(T, Mapping) else T, f"{where} T_BS")


def _imu(folder: Path) -> Imu:
    table = _table(folder / "data.csv", 7)
    if not (folder / "sensor.yaml").is_file():
        return Imu(table[0], table[1][:, :3], table[1][:, 3:6])
    content, where = _sensor(folder)
    R = _body(content, where)[:3, :3]
    noise = imu_noise_in(content, where) if "gyroscope_noise_density" in content else InertialNoise()
    return Imu(table[0], table[1][:, :3] @ R.T, table[1][:, 3:6] @ R.T, noise)


def _truth(path: Path) -> Trajectory:
    time_s, rows = _table(path, 8)
    norm = np.linalg.norm(rows[:, 3:7], axis=1)
    if not np.allclose(norm, 1.0, atol=0.01):
        raise SemlocError(f"EuRoC {path}: quaternions of length {norm.min():.3f}; expected t, x y z, qw qx qy qz")
    T = pose_from(Rotation.from_quat(rows[:, [4, 5, 6, 3]]).as_matrix(), rows[:, :3])
    return Trajectory(time_s, T)


def _table(path: Path, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Times [s], each once, and the rest of the rows."""
    cells = read_cells(path, columns)
    time_s, _ = seconds(np.array([_whole(row[0], path) for row in cells], dtype=np.int64), f"EuRoC {path}", "t_ns")
    try:
        values = np.array([[float(cell) for cell in row[1:columns]] for row in cells])
    except ValueError as error:
        raise SemlocError(f"EuRoC {path}: {error}; expected numbers") from error
    time_s, keep = np.unique(time_s, return_index=True)
    return time_s, values[keep]


def _whole(cell: str, where: Path) -> int:
    text = cell.strip()
    if not text.isdigit() or len(text) > 19:
        raise SemlocError(f"EuRoC {where}: time '{text[:30]}'; expected whole nanoseconds such as 1403636579763555584")
    return int(text)
