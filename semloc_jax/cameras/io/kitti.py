"""KITTI calibrations: odometry / object calib.txt and raw calib_cam_to_cam.txt (room: cameras; host).

In: P0 ... P3 (rectified pinholes) and Tr, or P_rect_0N with S_rect_0N, R_rect_00 and calib_velo_to_cam.txt beside it.
Out: Rig of the rectified cameras. The base is under the rear axle, from the published drawing of the car: the lidar
stands 1.73 m above the road and 0.76 m ahead of the rear axle.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from semloc_jax.cameras.io.fields import check_focal, intrinsics_of, numbers, read_text, rigid
from semloc_jax.cameras.pinhole import PinholeCamera
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError

_LIDAR_BASE_M = (0.76, 0.0, 1.73)
_LIDAR_TO_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
"""Cameras 8 cm below and 27 cm ahead of the lidar: the drawing, where no Tr is given."""
_RESOLUTION = (1241, 376)


def is_kitti(path: Path) -> bool:
    """Whether a file is a KITTI calibration."""
    if path.suffix != ".txt" or path.stat().st_size > 1_000_000:
        return False
    keys = _content(path)
    return any(key in keys for key in ("P0", "P2", "P_rect_00", "P_rect_02"))


def rig_from_kitti(path: Path, size_px: tuple[int, int] | None = None) -> Rig:
    """The rectified cameras, named image_0 ... image_3 (odometry) or image_00 ... image_03 (raw).

    Args:
        path: calib.txt, or calib_cam_to_cam.txt.
        size_px: size of the images, where the file does not state it; None takes that of the odometry sequences.
    """
    content, where = _content(path), f"calibration {path}"
    is_raw = "P_rect_00" in content or "P_rect_02" in content
    T_cam0_lidar = _lidar(content, path, where) if not is_raw else _raw_lidar(content, path, where)
    T_base_cam0 = _translation(_LIDAR_BASE_M) @ np.linalg.inv(T_cam0_lidar)
    cameras, poses, names = [], [], []
    for number in range(4):
        key = f"P_rect_{number:02d}" if is_raw else f"P{number}"
        if key not in content:
            continue
        P = numbers(content[key], (12,), f"{where} {key}").reshape(3, 4)
        fx, fy, cx, cy = intrinsics_of(P[:, :3].ravel(), f"{where} {key}")
        check_focal(fx, fy, f"{where} {key}")
        size = content.get(f"S_rect_{number:02d}")
        width, height = numbers(size, (2,), f"{where} S_rect") if size else (size_px or _RESOLUTION)
        cameras.append(PinholeCamera(fx, fy, cx, cy, width, height))
        # P = K [I | t] with t the place of camera 0 in this camera.
        poses.append(T_base_cam0 @ _translation(-np.linalg.solve(P[:, :3], P[:, 3])))
        names.append(f"image_{number:02d}" if is_raw else f"image_{number}")
    if not cameras:
        raise SemlocError(f"calibration {path}: no projection matrix in it; expected lines such as P2: or P_rect_02:")
    return Rig(cameras, np.stack(poses), names)


def _lidar(content: Mapping[str, list[str]], path: Path, where: str) -> np.ndarray:
    key = next((key for key in ("Tr", "Tr_velo_to_cam", "Tr_velo_cam") if key in content), None)
    T = _LIDAR_TO_CAMERA if key is None else rigid(numbers(content[key], (12,), f"{where} {key}"), f"{where} {key}")
    return _rectification(content, "R0_rect", where) @ T


def _raw_lidar(content: Mapping[str, list[str]], path: Path, where: str) -> np.ndarray:
    beside = path.with_name("calib_velo_to_cam.txt")
    T = _LIDAR_TO_CAMERA
    if beside.is_file():
        lidar, place = _content(beside), f"calibration {beside}"
        if "R" not in lidar or "T" not in lidar:
            raise SemlocError(f"{place}: has keys {', '.join(lidar)}; expected R and T")
        R, t = numbers(lidar["R"], (9,), f"{place} R"), numbers(lidar["T"], (3,), f"{place} T")
        T = rigid(np.column_stack([R.reshape(3, 3), t]), place)
    return _rectification(content, "R_rect_00", where) @ T


def _rectification(content: Mapping[str, list[str]], key: str, where: str) -> np.ndarray:
    if key not in content:
        return np.eye(4)
    R = numbers(content[key], (9,), f"{where} {key}").reshape(3, 3)
    return rigid(np.column_stack([R, np.zeros(3)]), f"{where} {key}")


def _translation(t: object) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = t
    return T


def _content(path: Path) -> dict[str, list[str]]:
    lines = [line.partition(":") for line in read_text(path).splitlines() if ":" in line]
    return {key.strip(): value.split() for key, _, value in lines}
