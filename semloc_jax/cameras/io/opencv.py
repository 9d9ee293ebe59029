"""OpenCV FileStorage calibrations, yaml or xml (room: cameras; host).

In: camera_matrix, dist_coeffs, image size under the names that OpenCV's samples use. Out: Rig of one camera.
"""

import logging
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from semloc_jax.cameras.io.camera_info import pose_of
from semloc_jax.cameras.io.fields import intrinsics_of, load_yaml, numbers, perspective, read_text, resolution
from semloc_jax.cameras.io.ground_homography import KEYS as GROUND_KEYS
from semloc_jax.cameras.io.ground_homography import pose_of_homography
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError

_log = logging.getLogger(__name__)
_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "Distortion_Coefficients", "D")
_SIZE = ("resolution", "image_size", "imageSize")
_KEYS = (
    *_MATRIX,
    *_DISTORTION,
    *_SIZE,
    "image_width",
    "image_height",
    "fisheye_model",
    "distortion_model",
    "T_base_cam",
    "T_body_cam",
    *GROUND_KEYS,
)


def is_opencv(path: Path) -> bool:
    """Whether the file holds matrices as OpenCV's FileStorage writes them."""
    content = path.read_bytes()
    return b"!!opencv-matrix" in content or b"<opencv_storage>" in content


def rig_from_opencv(path: Path) -> Rig:
    """The camera of a FileStorage; four coefficients without a named model are a fisheye, as cv2.fisheye writes."""
    where = f"calibration {path}"
    content = _load(path, where)
    intrinsics = intrinsics_of(numbers(_first(content, _MATRIX, where), (9,), f"{where} camera matrix"), where)
    coefficients = numbers(_first(content, _DISTORTION, where), (0, 4, 5, 8, 12, 14), f"{where} distortion")
    if "image_width" in content and "image_height" in content:
        size = resolution([content["image_width"], content["image_height"]], f"{where} image size")
    else:
        size = resolution(_first(content, _SIZE, where), f"{where} image size")
    camera = perspective(intrinsics, size, _model(content, coefficients, where), coefficients, where)
    if "project_matrix" in content and not {"T_base_cam", "T_body_cam"} & set(content):
        pose = pose_of_homography(content, tuple(float(x) for x in intrinsics), path.stem, where)
    else:
        pose = pose_of(content, where)
    return Rig([camera], pose[None], [path.stem])


def _load(path: Path, where: str) -> dict[str, Any]:
    """Values by key; read here, since OpenCV itself ends the whole process on some damaged files."""
    if path.read_bytes().lstrip().startswith(b"<"):
        return _load_xml(path, where)
    try:
        content = load_yaml(path)
    except SemlocError as error:
        raise SemlocError(f"{where}: not readable as an OpenCV FileStorage; check the file") from error
    return {key: _value(value) for key, value in content.items() if key in _KEYS}


def _load_xml(path: Path, where: str) -> dict[str, Any]:
    text = read_text(path)
    if "<!" in text.replace("<!--", ""):
        raise SemlocError(f"{where}: declares entities; expected a plain OpenCV FileStorage")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise SemlocError(f"{where}: not readable as an OpenCV FileStorage; check the file") from error
    found = {}
    for node in root:
        data = node.find("data")
        words = ((node if data is None else data).text or "").replace('"', " ").split()
        if node.tag in _KEYS and words:
            found[node.tag] = words[0] if len(words) == 1 and data is None else words
    return found


def _value(value: Any) -> Any:
    """The numbers of a matrix, everything else unchanged."""
    return value.get("data") if isinstance(value, dict) else value


def _first(content: dict[str, Any], keys: tuple[str, ...], where: str) -> Any:
    for key in keys:
        if content.get(key) is not None:
            return content[key]
    raise SemlocError(f"{where}: none of the keys {', '.join(keys)} is there; add one")


def _model(content: dict[str, Any], coefficients: np.ndarray, where: str) -> str:
    if "distortion_model" in content:
        return str(content["distortion_model"])
    if "fisheye_model" in content:
        return "equidistant" if numbers(content["fisheye_model"], (1,), "fisheye_model")[0] else "radtan"
    if coefficients.size > 5:
        return "rational"
    if coefficients.size == 4:
        _log.warning("%s: four distortion coefficients are read as a fisheye (add fisheye_model: 0 for radtan)", where)
    return {0: "none", 4: "equidistant", 5: "radtan"}[coefficients.size]
