"""A corrected calibration written in the layout of the file that it corrects (room: cameras; host).

In: Rig, the file or folder it was read from. Out: a file (or a file for each camera) with the same keys, poses and,
where they changed, lenses replaced.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from semloc_jax.cameras.base import Camera
from semloc_jax.cameras.io.camchain import is_camchain, rig_from_camchain, write_calibration
from semloc_jax.cameras.io.fields import load_yaml
from semloc_jax.cameras.io.woodscape import is_woodscape, rig_from_woodscape
from semloc_jax.cameras.models import model_of
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.storage import write_text

_POSE_KEYS = ("T_body_cam", "T_base_cam", "T_imu_cam", "T_cam_imu", "T_cn_cnm1")


def write_corrected(rig: Rig, source: str | Path, folder: str | Path) -> tuple[Path, ...]:
    """The files written: calib.yaml of a camchain, one json for each camera of WoodScape, each with the keys it had.

    Cameras that are not in the rig stay unchanged. Any other layout becomes a calib.yaml in the `drive` layout.

    Args:
        rig: Corrected cameras, named as in the source.
        source: File or folder that the calibration was read from.
        folder: Where to write; made if absent.
    """
    source, folder = Path(source), Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    own = source / "calib.yaml" if source.is_dir() and (source / "calib.yaml").is_file() else source
    if own.is_file() and own.suffix in (".yaml", ".yml", ".json"):
        content = load_yaml(own)
        if is_camchain(content):
            return (_camchain(content, rig, own, folder / "calib.yaml"),)
        if is_woodscape(content):
            return (_woodscape(content, rig, own, folder / own.name),)
    if source.is_dir():
        files = [file for file in sorted(source.glob("*.json")) if is_woodscape(load_yaml(file))]
        if files:
            return tuple(_woodscape(load_yaml(file), rig, file, folder / file.name) for file in files)
    write_calibration(rig, folder / "calib.yaml")
    return (folder / "calib.yaml",)


def _camchain(content: dict[str, Any], rig: Rig, source: Path, path: Path) -> Path:
    """The camchain with poses under the keys that they had; leading comments are kept."""
    before = rig_from_camchain(content, source)
    keys = sorted((key for key in content if str(key).startswith("cam")), key=lambda key: int(str(key)[3:]))
    best = [rig if name in rig.names else before for name in before.names]
    poses = [np.asarray(own.T_base_cam[own.index(name)]) for own, name in zip(best, before.names, strict=True)]
    for number, (key, name) in enumerate(zip(keys, before.names, strict=True)):
        entry = content[key]
        pose_key = next((k for k in _POSE_KEYS if k in entry), "T_body_cam")
        T = poses[number]
        if pose_key == "T_cam_imu":
            T = np.linalg.inv(T)
        elif pose_key == "T_cn_cnm1":
            T = np.linalg.inv(T) @ poses[number - 1]
        entry.pop("mounted", None)  # angles of a level do not hold what a calibration finds
        entry[pose_key] = [[float(value) for value in row] for row in T]
        if name in rig.names:
            _write_lens(entry, before.cameras[number], rig.cameras[rig.index(name)])
    lines = source.read_text(encoding="utf-8").splitlines()
    comments = [line for line in lines[: _first_content(lines)] if line.startswith("#")]
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
    write_text(path, "\n".join([*comments, text]))
    return path


def _first_content(lines: list[str]) -> int:
    return next((k for k, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines))


def _write_lens(entry: dict[str, Any], before: Camera, after: Camera) -> None:
    """Numbers of the lens that changed; the file has as many coefficients as it had."""
    model = model_of(after)
    intrinsics = ("fx", "fy", "cx", "cy") if model is None else model.intrinsics
    if _changed(before, after, intrinsics):
        entry["intrinsics"] = [float(getattr(after, name)) for name in intrinsics]
    names = () if model is None else model.coefficients
    if names and _changed(before, after, names):
        values = [float(getattr(after, name)) for name in names]
        given = len(entry.get("distortion_coeffs", []))
        if any(values[given:]):
            given = len(values)
        entry["distortion_coeffs"] = values[:given]


def _changed(before: Camera, after: Camera, names: tuple[str, ...]) -> bool:
    return any(float(getattr(before, name)) != float(getattr(after, name)) for name in names)


def _woodscape(content: dict[str, Any], rig: Rig, source: Path, path: Path) -> Path:
    """The WoodScape file with quaternion, translation and, where it changed, the lens."""
    before = rig_from_woodscape(content, source)
    name = before.names[0]
    if name not in rig.names:
        raise SemlocError(f"calibration {source}: camera '{name}' is not in the corrected rig {', '.join(rig.names)}")
    T, camera = np.asarray(rig.T_base_cam[rig.index(name)]), rig.cameras[rig.index(name)]
    content["extrinsic"]["quaternion"] = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    content["extrinsic"]["translation"] = T[:3, 3].tolist()
    lens = content["intrinsic"]
    if _changed(before.cameras[0], camera, ("fx", "fy", "cx", "cy", "c2", "c3", "c4")):
        fx = float(camera.fx)
        lens |= {"k1": fx, "k2": fx * float(camera.c2), "k3": fx * float(camera.c3), "k4": fx * float(camera.c4)}
        lens["aspect_ratio"] = float(camera.fy) / fx
        width, height = camera.resolution
        lens["cx_offset"] = float(camera.cx) - 0.5 * width + 0.5
        lens["cy_offset"] = float(camera.cy) - 0.5 * height + 0.5
    write_text(path, json.dumps(content, indent=4) + "\n")
    return path
