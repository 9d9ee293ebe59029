"""Argoverse 2 calibrations (room: cameras; host).

In: calibration/intrinsics.feather and egovehicle_SE3_sensor.feather of a log. Out: Rig. The images of the data set are
published without distortion, so that its k1 k2 k3 are not used. Its vehicle frame is at the height of the rear axle.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from semloc_jax.cameras.io.fields import check_focal, numbers, resolution, rigid
from semloc_jax.cameras.pinhole import PinholeCamera
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError, install_command

AXLE_HEIGHT_M = 0.33
"""Rear axle above the road: lidar points of the road beside the car lie 0.33 to 0.35 m below it (log 7fab2350)."""
_INTRINSICS, _EXTRINSICS = "intrinsics.feather", "egovehicle_SE3_sensor.feather"


def is_argoverse2(path: Path) -> bool:
    """Whether a folder is a log of Argoverse 2 or its folder `calibration`."""
    return any((place / _INTRINSICS).is_file() for place in (path, path / "calibration"))


def rig_from_argoverse2(path: Path) -> Rig:
    """The cameras of a log; the base is the vehicle frame, lowered to the road."""
    folder = path if (path / _INTRINSICS).is_file() else path / "calibration"
    lenses, places = read_feather(folder / _INTRINSICS), read_feather(folder / _EXTRINSICS)
    where = f"calibration {folder}"
    need = ("sensor_name", "fx_px", "fy_px", "cx_px", "cy_px", "width_px", "height_px")
    _check(lenses, need, f"{where}/{_INTRINSICS}")
    _check(places, ("sensor_name", "qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"), f"{where}/{_EXTRINSICS}")
    sensors = list(places["sensor_name"])
    cameras, poses = [], []
    for row, name in enumerate(lenses["sensor_name"]):
        if name not in sensors:
            raise SemlocError(f"{where}: {_EXTRINSICS} lacks sensor '{name}'; expected every camera")
        values = numbers([lenses[key][row] for key in need[1:]], (6,), f"{where}: {name}")
        check_focal(values[0], values[1], f"{where}: {name}")
        resolution(values[4:], f"{where}: {name}")
        cameras.append(PinholeCamera(*values))
        at = sensors.index(name)
        T = pose_of_row(places, at, f"{where}: {name}")
        T[2, 3] += AXLE_HEIGHT_M
        poses.append(T)
    return Rig(cameras, np.stack(poses), list(lenses["sensor_name"]))


def pose_of_row(table: dict[str, list], row: int, where: str) -> np.ndarray:
    """Rigid motion [4 4] of a row with qw qx qy qz and tx_m ty_m tz_m."""
    T = np.eye(4)
    quaternion = [float(table[key][row]) for key in ("qx", "qy", "qz", "qw")]
    if not np.isfinite(quaternion).all() or np.linalg.norm(quaternion) < 1e-6:
        raise SemlocError(f"{where}: quaternion {quaternion}; expected a unit quaternion")
    T[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    translation = [float(table[key][row]) for key in ("tx_m", "ty_m", "tz_m")]
    T[:3, 3] = translation
    return rigid(T, where)


def read_feather(path: Path) -> dict[str, list]:
    """Columns of a feather file.

    Raises:
        SemlocError: pyarrow is not installed, or the file is missing or damaged.
    """
    try:
        from pyarrow import ArrowException, feather
    except ImportError as error:
        raise SemlocError(
            f"{path.name}: the library pyarrow is not installed; run: {install_command('argoverse')}"
        ) from error
    if not path.is_file():
        raise SemlocError(f"{path}: no such file; expected the folder of one Argoverse 2 log")
    try:
        return feather.read_table(path, memory_map=False).to_pydict()
    except (ArrowException, OSError, ValueError) as error:
        raise SemlocError(f"{path}: not readable as feather ({str(error)[:120]}); copy it again") from error


def _check(table: dict[str, list], columns: tuple[str, ...], where: str) -> None:
    missing = [column for column in columns if column not in table]
    if missing:
        raise SemlocError(f"{where}: has columns {', '.join(table)}; expected also {', '.join(missing)}")
