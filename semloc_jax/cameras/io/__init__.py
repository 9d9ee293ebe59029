"""Calibration files to rigs and back (room: cameras; host).

In: a path. Out: Rig. The kind of file is guessed from its content: camchain (the `drive` layout, Kalibr), ROS
CameraInfo, OpenCV FileStorage, COLMAP, KITTI, OCamCalib, WoodScape; folders of Argoverse 2 and nuScenes; any other
folder is read as one file for each camera.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from semloc_jax.cameras.io.argoverse2 import is_argoverse2, rig_from_argoverse2
from semloc_jax.cameras.io.camchain import is_camchain, rig_from_camchain, write_calibration
from semloc_jax.cameras.io.camera_info import is_camera_info, rig_from_camera_info
from semloc_jax.cameras.io.colmap import is_colmap, rig_from_colmap
from semloc_jax.cameras.io.fields import load_yaml
from semloc_jax.cameras.io.from_matrix import camera_from_K
from semloc_jax.cameras.io.kitti import is_kitti, rig_from_kitti
from semloc_jax.cameras.io.nuscenes import nuscenes_tables, rig_from_nuscenes
from semloc_jax.cameras.io.ocamcalib import is_ocamcalib, rig_from_ocamcalib
from semloc_jax.cameras.io.opencv import is_opencv, rig_from_opencv
from semloc_jax.cameras.io.woodscape import is_woodscape, rig_from_woodscape
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.storage import reading

__all__ = ["camera_from_K", "read_calibration", "write_calibration"]

_SUFFIXES = (".yaml", ".yml", ".xml", ".json", ".txt")
_TEXTS: tuple[tuple[Callable[[Path], bool], Callable[[Path], Rig]], ...] = (
    (is_opencv, rig_from_opencv),
    (is_kitti, rig_from_kitti),
    (is_ocamcalib, rig_from_ocamcalib),
    (is_colmap, rig_from_colmap),
)
_MAX_BYTES = 10_000_000
"""Calibrations are small; a larger file is something else."""


def read_calibration(path: str | Path) -> Rig:
    """The cameras of a calibration file or folder.

    Files without extrinsics (ROS CameraInfo, OpenCV) give an identity T_base_cam and a log message that says so; a key
    `T_base_cam` (4x4) in them is used. Kalibr extrinsics are relative to the IMU, which then stands for the base.

    Args:
        path: A file, or a folder with `calib.yaml` or one file for each camera (named by the file).

    Raises:
        SemlocError: Missing file or key, wrong sizes, numbers that are not finite, poses that are not rigid.

    >>> front = sj.read_calibration(folder / "calib.yaml")
    >>> front.names, front.cameras[0].resolution, front.T_base_cam.shape
    (('front',), (480, 300), (1, 4, 4))
    """
    path = Path(path)
    if path.is_dir():
        return _read_folder(path)
    if not path.is_file():
        raise SemlocError(f"calibration {path}: no such file; expected a calibration yaml")
    if path.stat().st_size > _MAX_BYTES:
        raise SemlocError(f"calibration {path}: {path.stat().st_size / 1e6:.0f} MB; expected a small text file")
    with reading(f"calibration {path}"):
        return _read_file(path)


def _read_file(path: Path) -> Rig:
    """The cameras of one file."""
    for fits, read in _TEXTS:
        if fits(path):
            return read(path)
    if path.name == "calibrated_sensor.json":
        return rig_from_nuscenes(path.parent)
    content = load_yaml(path)
    if is_woodscape(content):
        return rig_from_woodscape(content, path)
    if is_camchain(content):
        return rig_from_camchain(content, path)
    if is_camera_info(content):
        return rig_from_camera_info(content, path)
    raise SemlocError(
        f"calibration {path}: keys {list(content)[:6]} match no known layout; expected cam0, cam1 ... (camchain), "
        "camera_matrix or K with distortion_model (ROS CameraInfo), intrinsic with cx_offset (WoodScape), an OpenCV "
        "FileStorage, or a text file of KITTI, COLMAP or OCamCalib"
    )


def _read_folder(path: Path) -> Rig:
    for name in ("calib.yaml", "calib_cam_to_cam.txt", "calib.txt", "cameras.txt"):
        if (path / name).is_file():
            return read_calibration(path / name)
    if is_argoverse2(path):
        return rig_from_argoverse2(path)
    if nuscenes_tables(path) is not None:
        return rig_from_nuscenes(path)
    files = sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)
    if not files:
        raise SemlocError(f"calibration {path}: the folder holds no {', '.join(_SUFFIXES)} file; expected calib.yaml")
    rigs = [read_calibration(file) for file in files]
    cameras = [camera for rig in rigs for camera in rig.cameras]
    names = [name for rig in rigs for name in rig.names]
    if len(set(names)) < len(names):
        names = [
            file.stem if len(r) == 1 else f"{file.stem}_{n}"
            for file, r in zip(files, rigs, strict=True)
            for n in r.names
        ]
    return Rig(cameras, np.concatenate([rig.T_base_cam for rig in rigs]), names)
