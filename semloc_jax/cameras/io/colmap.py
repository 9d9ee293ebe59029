"""COLMAP cameras.txt (room: cameras; host).

In: lines `CAMERA_ID MODEL WIDTH HEIGHT PARAMS`. Out: Rig; COLMAP has no vehicle frame, so every pose is the identity.
"""

import logging
from pathlib import Path

import numpy as np

from semloc_jax.cameras.base import Camera
from semloc_jax.cameras.io.fields import numbers, perspective, rational, read_text, resolution
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError

_log = logging.getLogger(__name__)
_PARAMETERS = {
    "SIMPLE_PINHOLE": (3, "none"),
    "PINHOLE": (4, "none"),
    "SIMPLE_RADIAL": (4, "radtan"),
    "RADIAL": (5, "radtan"),
    "OPENCV": (8, "radtan"),
    "FULL_OPENCV": (12, "rational"),
    "SIMPLE_RADIAL_FISHEYE": (4, "equidistant"),
    "RADIAL_FISHEYE": (5, "equidistant"),
    "OPENCV_FISHEYE": (8, "equidistant"),
}
"""Number of parameters and distortion of each model."""
_ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")


def is_colmap(path: Path) -> bool:
    """Whether a file is COLMAP's list of cameras."""
    if path.suffix != ".txt" or path.stat().st_size > 1_000_000:
        return False
    words = [line.split() for line in _lines(path)]
    return bool(words) and all(len(line) > 4 and line[1].isupper() and line[0].isdigit() for line in words)


def rig_from_colmap(path: Path) -> Rig:
    """The cameras of a cameras.txt, named by their number."""
    cameras, names = [], []
    for line in _lines(path):
        number, model, *rest = line.split()
        where = f"calibration {path}: camera {number}"
        cameras.append(_camera(model, rest, where))
        names.append(f"cam{number}")
    _log.warning("calibration %s: COLMAP has no vehicle; every T_base_cam is the identity (write a camchain)", path)
    return Rig(cameras, np.tile(np.eye(4), (len(cameras), 1, 1)), names)


def _camera(model: str, rest: list[str], where: str) -> Camera:
    if model not in _PARAMETERS:
        raise SemlocError(f"{where}: model '{model}' is not supported; expected one of {', '.join(_PARAMETERS)}")
    count, distortion = _PARAMETERS[model]
    size = resolution(numbers(rest[:2], (2,), f"{where} size"), f"{where} size")
    values = numbers(rest[2:], (count,), f"{where} ({model})")
    fx, fy, (cx, cy), k = (
        (values[0], values[0], values[1:3], values[3:])
        if model in _ONE_FOCAL
        else (values[0], values[1], values[2:4], values[4:])
    )
    # COLMAP puts the centre of the top-left pixel at (0.5, 0.5).
    intrinsics = np.array([fx, fy, cx - 0.5, cy - 0.5])
    if distortion == "rational":
        return rational(intrinsics, size, k, where)
    wanted = {"none": 0, "radtan": 5 if model == "OPENCV" else 4, "equidistant": 4}[distortion]
    return perspective(intrinsics, size, distortion, np.pad(k, (0, wanted - len(k))), where)


def _lines(path: Path) -> list[str]:
    lines = [line.split("#", 1)[0].strip() for line in read_text(path).splitlines()]
    return [line for line in lines if line]
