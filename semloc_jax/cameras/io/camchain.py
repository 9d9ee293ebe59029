"""Camchain files: the `drive` layout and Kalibr's (room: cameras; host).

In: cam0, cam1 ... with intrinsics, distortion and T_body_cam or angles under `mounted` (drive), T_cam_imu or T_cn_cnm1
(Kalibr), T_imu_cam (OpenVINS). Out: Rig, and back.
"""

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
import yaml
from jaxtyping import Float

from semloc_jax.cameras.base import Camera, as_leaf
from semloc_jax.cameras.io.fields import camera_of, numbers, perspective, required, resolution, rigid
from semloc_jax.cameras.models import MODELS, find_model, model_of
from semloc_jax.cameras.rig import Rig, mounted
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.rigid import inverse
from semloc_jax.storage import write_text

_log = logging.getLogger(__name__)
_KEY = re.compile(r"cam(\d+)")
_ANGLES = ("yaw_deg", "down_deg", "roll_deg")
_HEADER = (
    "# pixel centres at integer coordinates; T_body_cam maps camera (x right, y down, z forward) to body\n"
    "# (rear axle on the ground, x forward, y left, z up)\n"
)


def is_camchain(content: Mapping[str, Any]) -> bool:
    """Whether the content has cam0, cam1 ... as its keys."""
    return any(_KEY.fullmatch(str(key)) for key in content)


def rig_from_camchain(content: Mapping[str, Any], path: Path) -> Rig:
    """The rig of a camchain; poses from T_body_cam, `mounted`, T_imu_cam or T_cam_imu (IMU as base), or T_cn_cnm1."""
    keys = sorted((key for key in content if _KEY.fullmatch(str(key))), key=lambda key: int(_KEY.fullmatch(key)[1]))
    cameras, poses, names = [], [], []
    for key in keys:
        entry, where = content[key], f"calibration {path}: {key}"
        if not isinstance(entry, Mapping):
            raise SemlocError(f"{where}: given {repr(entry)[:80]}; expected a mapping with intrinsics, resolution ...")
        cameras.append(_camera(entry, where))
        poses.append(_pose(entry, poses[-1] if poses else None, where))
        names.append(str(entry.get("name", key)))
    return Rig(cameras, np.stack(poses), names)


def write_calibration(rig: Rig, path: str | Path) -> None:
    """Writes the rig as a camchain in the `drive` layout; `read_calibration` gives the same rig back.

    Raises:
        SemlocError: a camera whose model has no row in `cameras.models`.

    >>> sj.write_calibration(drive.rig, tmp / "calib.yaml")
    >>> sj.read_calibration(tmp / "calib.yaml").names
    ('front',)
    """
    content = {f"cam{i}": _entry(rig, i) for i in range(len(rig))}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
    write_text(path, _HEADER + text)


def _camera(entry: Mapping[str, Any], where: str) -> Camera:
    projection = str(entry.get("camera_model", "pinhole")).strip().lower()
    row = find_model(projection, str(entry.get("distortion_model", "")))
    num_leading = 0 if row is None else len(row.leading)
    given = numbers(required(entry, "intrinsics", where), (num_leading + 4,), f"{where} intrinsics")
    leading, intrinsics = given[:num_leading], given[num_leading:]
    size = resolution(required(entry, "resolution", where), f"{where} resolution")
    coefficients = entry.get("distortion_coeffs", [])
    if projection == "pinhole":
        camera = perspective(intrinsics, size, str(required(entry, "distortion_model", where)), coefficients, where)
    else:
        distortion = str(entry.get("distortion_model", ""))
        camera = camera_of(projection, distortion, intrinsics, size, coefficients, where, leading)
    model = model_of(camera)
    for limit in model.limits if model else ():
        if limit in entry:
            value = numbers(entry[limit], (1,), f"{where} {limit}")[0]
            camera = eqx.tree_at(lambda c, limit=limit: getattr(c, limit), camera, as_leaf(value))
    return camera


def _pose(entry: Mapping[str, Any], previous: np.ndarray | None, where: str) -> Float[np.ndarray, "4 4"]:
    for key in ("T_body_cam", "T_base_cam", "T_imu_cam"):
        if key in entry:
            return rigid(entry[key], f"{where} {key}")
    if "mounted" in entry:
        return _mounted(entry["mounted"], f"{where} mounted")
    if "T_cam_imu" in entry:
        return inverse(rigid(entry["T_cam_imu"], f"{where} T_cam_imu"))
    if "T_cn_cnm1" in entry and previous is not None:
        return previous @ inverse(rigid(entry["T_cn_cnm1"], f"{where} T_cn_cnm1"))
    if previous is not None:
        raise SemlocError(f"{where}: no pose; expected T_body_cam, mounted, T_cam_imu or T_cn_cnm1")
    _log.warning("%s: no pose; this camera is taken as the base frame (add T_body_cam or mounted)", where)
    return np.eye(4)


def _mounted(value: Any, where: str) -> Float[np.ndarray, "4 4"]:
    """The pose of a camera measured with a rule and a level: position_m, and degrees that may be left out."""
    if not isinstance(value, Mapping) or not set(value) <= {"position_m", *_ANGLES}:
        raise SemlocError(f"{where}: given {repr(value)[:80]}; expected position_m: [x, y, z] and {', '.join(_ANGLES)}")
    position_m = numbers(required(value, "position_m", where), (3,), f"{where} position_m")
    angles_deg = [numbers(value.get(name, 0.0), (1,), f"{where} {name}")[0] for name in _ANGLES]
    return rigid(mounted(position_m.tolist(), *angles_deg), where)


def _entry(rig: Rig, index: int) -> dict[str, Any]:
    camera = rig.cameras[index]
    model = model_of(camera)
    if model is None:
        raise SemlocError(
            f"camera {rig.names[index]}: a calibration file has no name for {type(camera).__name__}; expected one of "
            f"{', '.join(known.camera.__name__ for known in MODELS)}; add a row to cameras.models.MODELS"
        )
    entry: dict[str, Any] = {"name": rig.names[index], "camera_model": model.projection}
    if model.distortion:
        entry["distortion_model"] = model.distortion[0]
    if model.distortion or model.coefficients:
        entry["distortion_coeffs"] = [float(getattr(camera, name)) for name in model.coefficients]
    entry["intrinsics"] = [float(getattr(camera, name)) for name in model.intrinsics]
    entry["resolution"] = list(camera.resolution)
    entry |= {limit: float(getattr(camera, limit)) for limit in model.limits}
    entry["T_body_cam"] = [[float(value) for value in row] for row in rig.T_base_cam[index]]
    return entry
