"""ROS CameraInfo: the calibration file and the printed message (room: cameras; host).

In: camera_matrix / K, distortion_coefficients / D, distortion_model, image size. Out: Rig of one camera.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from semloc_jax.cameras.base import Camera
from semloc_jax.cameras.io.fields import intrinsics_of, numbers, perspective, required, resolution, rigid
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError

_log = logging.getLogger(__name__)
_MATRIX = ("camera_matrix", "K", "k")
_DISTORTION = ("distortion_coefficients", "D", "d")


def is_camera_info(content: Mapping[str, Any]) -> bool:
    """Whether the content is a ROS camera calibration."""
    return "distortion_model" in content and any(key in content for key in _MATRIX)


def rig_from_camera_info(content: Mapping[str, Any], path: Path) -> Rig:
    """The camera of a CameraInfo, with T_base_cam from a key of that name, else identity."""
    where = f"calibration {path}"
    camera = camera_from_info(content, where)
    return Rig([camera], pose_of(content, where)[None], [str(content.get("camera_name", path.stem))])


def camera_from_info(content: Mapping[str, Any], where: str) -> Camera:
    """The camera of the fields of a CameraInfo."""
    K = _data(content, _MATRIX, where)
    intrinsics = intrinsics_of(numbers(K, (9,), f"{where} camera_matrix"), where)
    width, height = content.get("image_width", content.get("width")), content.get("image_height", content.get("height"))
    size = resolution([width, height], f"{where} image_width, image_height")
    distortion = _data(content, _DISTORTION, where)
    return perspective(intrinsics, size, _model(content, distortion), distortion, where)


def pose_of(content: Mapping[str, Any], where: str) -> Float[np.ndarray, "4 4"]:
    """T_base_cam of a file that may hold it under that name."""
    for key in ("T_base_cam", "T_body_cam"):
        if content.get(key) is not None:
            return rigid(content[key], f"{where} {key}")
    _log.warning("%s: no extrinsics; T_base_cam is the identity (add the key T_base_cam, 4x4)", where)
    return np.eye(4)


def _data(content: Mapping[str, Any], keys: tuple[str, ...], where: str) -> Any:
    for key in keys:
        if key in content:
            return (
                required(content[key], "data", f"{where} {key}") if isinstance(content[key], Mapping) else content[key]
            )
    raise SemlocError(f"{where}: key '{keys[0]}' is missing; add it")


def _model(content: Mapping[str, Any], distortion: Any) -> str:
    return str(content["distortion_model"]).strip().lower() if np.size(np.asarray(distortion, dtype=object)) else "none"
