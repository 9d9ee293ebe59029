"""Calibration files to rigs and back (room: cameras; host).

In: a path. Out: Rig. The kind of file is guessed from its content: camchain (the `drive` layout, Kalibr), ROS
CameraInfo, OpenCV FileStorage; a folder is read as one file for each camera.
"""

from pathlib import Path

import numpy as np

from semloc_jax.cameras.io.camchain import is_camchain, rig_from_camchain, write_calibration
from semloc_jax.cameras.io.camera_info import is_camera_info, rig_from_camera_info
from semloc_jax.cameras.io.fields import load_yaml
from semloc_jax.cameras.io.opencv import is_opencv, rig_from_opencv
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError

__all__ = ["read_calibration", "write_calibration"]

_SUFFIXES = (".yaml", ".yml", ".xml")


def read_calibration(path: str | Path) -> Rig:
    """The cameras of a calibration file or folder.

    Files without extrinsics (ROS CameraInfo, OpenCV) give an identity T_base_cam and a log message that says so; a key
    `T_base_cam` (4x4) in them is used. Kalibr extrinsics are relative to the IMU, which then stands for the base.

    Args:
        path: A file, or a folder with `calib.yaml` or one file for each camera (named by the file).

    Raises:
        SemlocError: Missing file or key, wrong sizes, numbers that are not finite, poses that are not rigid.
    """
    path = Path(path)
    if path.is_dir():
        return _read_folder(path)
    if not path.is_file():
        raise SemlocError(f"calibration {path}: no such file; expected a calibration yaml")
    if is_opencv(path):
        return rig_from_opencv(path)
    content = load_yaml(path)
    if is_camchain(content):
        return rig_from_camchain(content, path)
    if is_camera_info(content):
        return rig_from_camera_info(content, path)
    raise SemlocError(
        f"calibration {path}: keys {list(content)[:6]} match no known layout; expected cam0, cam1 ... (camchain), "
        "camera_matrix or K with distortion_model (ROS CameraInfo), or an OpenCV FileStorage"
    )


def _read_folder(path: Path) -> Rig:
    if (path / "calib.yaml").is_file():
        return read_calibration(path / "calib.yaml")
    files = sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)
    if not files:
        raise SemlocError(f"calibration {path}: the folder holds no {', '.join(_SUFFIXES)} file; expected calib.yaml")
    rigs = [read_calibration(file) for file in files]
    cameras = [camera for rig in rigs for camera in rig.cameras]
    names = [file.stem if len(rig) == 1 else name for file, rig in zip(files, rigs, strict=True) for name in rig.names]
    return Rig(cameras, np.concatenate([rig.T_base_cam for rig in rigs]), names)
