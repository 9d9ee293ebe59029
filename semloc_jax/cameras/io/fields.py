"""Checked fields of calibration files (room: cameras; host).

In: parsed content and a word that says where it stands. Out: arrays of the right size, or SemlocError.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

from semloc_jax.cameras.base import Camera
from semloc_jax.cameras.fisheye import KannalaBrandtCamera
from semloc_jax.cameras.pinhole import BrownConradyCamera, PinholeCamera
from semloc_jax.errors import SemlocError

_MAX_ROTATION_ERROR = 1e-3
_ROUNDING = 1e-14
_MAX_TRANSLATION_M = 50.0

RADTAN = ("radtan", "plumb_bob")
EQUIDISTANT = ("equidistant", "fisheye", "kannala_brandt")


def load_yaml(path: Path) -> dict[str, Any]:
    """The mapping at the top of a YAML file."""
    try:
        text = path.read_text(encoding="utf-8")
        # Tools built on OpenCV start plain YAML with a directive that YAML itself does not know.
        content = yaml.safe_load(text.replace("%YAML:", "# %YAML:", 1) if text.startswith("%YAML:") else text)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f" line {mark.line + 1}" if mark else ""
        raise SemlocError(f"calibration {path}{place}: not readable as YAML; check the file") from error
    if not isinstance(content, dict):
        raise SemlocError(f"calibration {path}: holds no keys; expected a mapping such as cam0: ...")
    return content


def required(entry: Mapping[str, Any], key: str, where: str) -> Any:
    """The value of a key that must be there."""
    if not isinstance(entry, Mapping) or entry.get(key) is None:
        raise SemlocError(f"{where}: key '{key}' is missing; add it")
    return entry[key]


def numbers(value: Any, counts: tuple[int, ...], where: str) -> Float[np.ndarray, " n"]:
    """Finite numbers, flattened, of one of the allowed counts."""
    try:
        array = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise SemlocError(f"{where}: given {value!r}; expected {_either(counts)} numbers") from error
    if array.size not in counts:
        raise SemlocError(f"{where}: given {array.size} numbers; expected {_either(counts)}")
    if not np.isfinite(array).all():
        raise SemlocError(f"{where}: given {array.tolist()}; expected finite numbers; calibrate again")
    return array


def rigid(value: Any, where: str) -> Float[np.ndarray, "4 4"]:
    """A rigid motion from 4x4 or 3x4 numbers, its rotation made exactly orthonormal.

    Raises:
        SemlocError: Wrong size, not finite, not a rotation, mirrored axes, a translation that is not in metres.
    """
    array = numbers(value, (16, 12), where)
    T = np.vstack([array.reshape(-1, 4)[:3], [0.0, 0.0, 0.0, 1.0]])
    if array.size == 16 and not np.allclose(array[12:], T[3], atol=1e-9):
        raise SemlocError(f"{where}: last row {array[12:].tolist()}; expected 0 0 0 1; is the matrix transposed?")
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > _MAX_ROTATION_ERROR:
        lengths = np.linalg.norm(R, axis=0).round(4).tolist()
        raise SemlocError(f"{where}: not a rotation (column lengths {lengths}); expected orthonormal columns")
    if np.linalg.det(R) < 0:
        raise SemlocError(f"{where}: determinant -1, an axis is mirrored; expected a right-handed frame: flip one axis")
    if np.abs(T[:3, 3]).max() > _MAX_TRANSLATION_M:
        raise SemlocError(f"{where}: translation {T[:3, 3].tolist()}; expected metres; is it in millimetres?")
    if np.abs(R @ R.T - np.eye(3)).max() > _ROUNDING:
        U, _, Vt = np.linalg.svd(R)
        T[:3, :3] = U @ Vt
    return T


def resolution(value: Any, where: str) -> Float[np.ndarray, " 2"]:
    """Width and height of the image [px]."""
    size = numbers(value, (2,), where)
    if (size < 1).any() or (size != np.round(size)).any():
        raise SemlocError(f"{where}: given {size.tolist()}; expected width and height in whole pixels")
    return size


def perspective(
    intrinsics: Float[np.ndarray, " 4"], size: Float[np.ndarray, " 2"], model: str, coefficients: Any, where: str
) -> Camera:
    """The camera of fx fy cx cy [px], image size [px], the name of a distortion model, and its coefficients."""
    if intrinsics[0] <= 0 or intrinsics[1] <= 0:
        raise SemlocError(f"{where}: focal lengths {intrinsics[:2].tolist()}; expected positive pixels")
    model = model.strip().lower()
    if model in ("none", ""):
        return PinholeCamera(*intrinsics, *size)
    if model in RADTAN:
        k1, k2, p1, p2, *k3 = numbers(coefficients, (4, 5), f"{where} (distortion {model}: k1 k2 p1 p2 [k3])")
        return BrownConradyCamera(*intrinsics, *size, k1, k2, p1, p2, *k3)
    if model in EQUIDISTANT:
        return KannalaBrandtCamera(*intrinsics, *size, *numbers(coefficients, (4,), f"{where} (distortion {model})"))
    raise SemlocError(
        f"{where}: distortion model '{model}' is not supported; expected radtan / plumb_bob, equidistant or none; "
        "calibrate with one of these, or undistort the images first"
    )


def _either(counts: tuple[int, ...]) -> str:
    return " or ".join(str(count) for count in counts)
