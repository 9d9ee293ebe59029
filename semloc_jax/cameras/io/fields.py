"""Checked fields of calibration files (room: cameras; host).

In: parsed content and its place in the file, for messages. Out: arrays of the right size, or SemlocError.
"""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

from semloc_jax.cameras.base import Camera
from semloc_jax.cameras.models import distortions, find_model, projections
from semloc_jax.cameras.pinhole import BrownConradyCamera
from semloc_jax.errors import SemlocError

_log = logging.getLogger(__name__)
_MAX_FIT_ERROR_PX = 1.0
_WORD_OF_FIT_ERROR_PX = 0.1
_MAX_ROTATION_ERROR = 1e-3
_ROUNDING = 1e-14
_MAX_TRANSLATION_M = 50.0
_LARGEST, _MOST_PIXELS, _FOCAL_PX = 1e9, 65535, (1.0, 1e6)
_MOST_VALUES = 100_000
"""A calibration holds some hundred numbers; aliases of YAML can grow a small file without bound."""

RATIONAL = ("rational_polynomial", "rational")


class _Loader(yaml.SafeLoader):
    """Plain YAML whose matrices may have the tag that OpenCV gives them."""


for _tag in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", lambda loader, node: loader.construct_mapping(node, deep=True))


def read_text(path: Path) -> str:
    """The text of a file.

    Raises:
        SemlocError: it is no text in UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise SemlocError(f"calibration {path}: not readable as text; check the file") from error


def load_yaml(path: Path) -> dict[str, Any]:
    """The mapping at the top of a YAML or JSON file."""
    text = read_text(path)
    try:
        # Tools built on OpenCV start plain YAML with a directive that YAML itself does not know.
        text = text.replace("%YAML:", "# %YAML:", 1) if text.startswith("%YAML:") else text
        content = yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f" line {mark.line + 1}" if mark else ""
        raise SemlocError(f"calibration {path}{place}: not readable as YAML; check the file") from error
    if not isinstance(content, dict):
        raise SemlocError(f"calibration {path}: holds no keys; expected a mapping such as cam0: ...")
    if _num_values(content, {}) > _MOST_VALUES:
        raise SemlocError(f"calibration {path}: more than {_MOST_VALUES} values; expected those of a few cameras")
    return {str(key): value for key, value in content.items()}


def _num_values(content: Any, known: dict[int, float]) -> float:
    """Number of values with every alias written out; infinite where content holds itself."""
    if not isinstance(content, dict | list):
        return 1.0
    if id(content) not in known:
        known[id(content)] = float("inf")
        parts = content.values() if isinstance(content, dict) else content
        known[id(content)] = 1.0 + sum(_num_values(part, known) for part in parts)
    return known[id(content)]


def required(entry: Mapping[str, Any], key: str, where: str) -> Any:
    """The value of a key that must be there."""
    if not isinstance(entry, Mapping) or entry.get(key) is None:
        raise SemlocError(f"{where}: key '{key}' is missing; add it")
    return entry[key]


def numbers(value: Any, counts: tuple[int, ...], where: str) -> Float[np.ndarray, " n"]:
    """Finite numbers, flattened, of one of the allowed counts."""
    try:
        array = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError) as error:
        raise SemlocError(f"{where}: given {repr(value)[:80]}; expected {_either(counts)} numbers") from error
    if array.size not in counts:
        raise SemlocError(f"{where}: given {array.size} numbers; expected {_either(counts)}")
    if not (np.abs(array) < _LARGEST).all():
        raise SemlocError(f"{where}: given {array.tolist()}; expected finite numbers below 1e9; calibrate again")
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
    if (size < 1).any() or (size > _MOST_PIXELS).any() or (size != np.round(size)).any():
        raise SemlocError(f"{where}: given {size.tolist()}; expected width and height in whole pixels")
    return size


def check_focal(fx: float, fy: float, where: str) -> None:
    """Refuses focal lengths that no camera has.

    Raises:
        SemlocError: they are not positive pixels.
    """
    if not all(_FOCAL_PX[0] < f < _FOCAL_PX[1] for f in (fx, fy)):
        raise SemlocError(f"{where}: focal lengths {fx:g}, {fy:g}; expected positive pixels, 1 to 1e6; calibrate again")


def intrinsics_of(K: Float[np.ndarray, " 9"], where: str) -> Float[np.ndarray, " 4"]:
    """fx fy cx cy of a camera matrix."""
    if np.abs(K[[1, 3, 6, 7]]).max() > 1e-9 or K[8] != 1:
        raise SemlocError(f"{where}: camera matrix {K.tolist()}; expected fx 0 cx / 0 fy cy / 0 0 1 (no skew)")
    return K[[0, 4, 2, 5]]


def perspective(
    intrinsics: Float[np.ndarray, " 4"], size: Float[np.ndarray, " 2"], model: str, coefficients: Any, where: str
) -> Camera:
    """The camera of fx fy cx cy [px], image size [px], the name of a distortion model, and its coefficients."""
    if model.strip().lower() in RATIONAL:
        check_focal(intrinsics[0], intrinsics[1], where)
        return rational(intrinsics, size, numbers(coefficients, (8, 12, 14), f"{where} (distortion {model})"), where)
    return camera_of("pinhole", model, intrinsics, size, coefficients, where)


def camera_of(
    projection: str,
    distortion: str,
    intrinsics: Float[np.ndarray, " 4"],
    size: Float[np.ndarray, " 2"],
    coefficients: Any,
    where: str,
    leading: Sequence[float] | np.ndarray = (),
) -> Camera:
    """The camera of the names and numbers of a file, by the table of models.

    Args:
        projection: `camera_model` of the file.
        distortion: `distortion_model` of the file.
        intrinsics: fx fy cx cy [px].
        size: width and height [px].
        coefficients: `distortion_coeffs` of the file.
        where: place in the file, for messages.
        leading: what the file has before fx in its `intrinsics`.

    Raises:
        SemlocError: no such model, no such number of coefficients, focal lengths that no camera has.
    """
    check_focal(intrinsics[0], intrinsics[1], where)
    model = find_model(projection, distortion)
    if model is None and projection not in projections():
        expected = ", ".join(projections())
        raise SemlocError(f"{where}: camera_model '{projection}' is not supported; expected one of {expected}")
    if model is None:
        raise SemlocError(
            f"{where}: distortion model '{distortion}' is not supported; expected one of {', '.join(distortions())}, "
            f"{RATIONAL[0]}; calibrate with one of these, or undistort the images first"
        )
    names = " ".join(model.coefficients)
    given = numbers(coefficients, model.counts, f"{where} (distortion {distortion}: {names})") if names else ()
    return model.camera.of_numbers((*intrinsics, *size), (*leading, *given))


def rational(
    intrinsics: Float[np.ndarray, " 4"], size: Float[np.ndarray, " 2"], coefficients: np.ndarray, where: str
) -> BrownConradyCamera:
    """The radtan camera that follows OpenCV's rational model k1 k2 p1 p2 k3 k4 k5 k6 best in its picture.

    A log message tells the largest difference in pixels where it is not exact.

    Raises:
        SemlocError: it differs by more than a pixel, or the coefficients of thin prisms or tilted sensors are used.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients[:8]
    if np.any(coefficients[8:]):
        raise SemlocError(f"{where}: thin-prism or tilt coefficients are not supported; undistort the images first")
    fx, fy, cx, cy = intrinsics
    corner = np.hypot(max(cx, size[0] - 1 - cx) / fx, max(cy, size[1] - 1 - cy) / fy)
    r = np.linspace(0.0, 6.0, 3000)
    s = r * r
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        factor = (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
        seen = np.logical_and.accumulate(
            np.isfinite(factor) & (r * factor <= corner) & np.concatenate([[True], np.diff(r * factor) > 0])
        )
    r, s, factor = r[seen], s[seen], factor[seen]
    if len(r) < 20:
        raise SemlocError(f"{where}: distortion {coefficients.tolist()} turns close to the centre; check its order")
    basis = (s[:, None] ** np.arange(1, 4)) * r[:, None]
    fit = _smallest_maximum(basis, r * (factor - 1.0)) if np.any([k4, k5, k6]) else np.array([k1, k2, k3])
    error_px = float(max(fx, fy) * np.abs(basis @ fit - r * (factor - 1.0)).max())
    if error_px > _MAX_FIT_ERROR_PX:
        raise SemlocError(
            f"{where}: the rational distortion (8 coefficients) is {error_px:.1f} px off its nearest k1 k2 p1 p2 k3; "
            "calibrate with plumb_bob or equidistant, or undistort the images first"
        )
    if error_px > _WORD_OF_FIT_ERROR_PX:
        _log.warning("%s: rational distortion read as k1 k2 p1 p2 k3, up to %.2f px off", where, error_px)
    return BrownConradyCamera(*intrinsics, *size, fit[0], fit[1], p1, p2, fit[2])


def _smallest_maximum(basis: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Coefficients whose largest error is about the smallest (Lawson's reweighted least squares)."""
    weight = np.full(len(target), 1.0 / len(target))
    for _ in range(60):
        root = np.sqrt(weight)[:, None]
        fit = np.linalg.lstsq(basis * root, target * root[:, 0], rcond=None)[0]
        error = np.abs(basis @ fit - target)
        if error.max() == 0.0:
            break
        weight = weight * error
        weight /= weight.sum()
    return fit


def _either(counts: tuple[int, ...]) -> str:
    return " or ".join(str(count) for count in counts)
