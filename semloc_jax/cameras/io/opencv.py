"""OpenCV FileStorage calibrations, yaml or xml, with the mount by a ground homography (room: cameras; host).

In: camera_matrix, dist_coeffs, image size under the names that OpenCV's samples use; the homography that lays the
undistorted picture on the ground. Out: Rig of one camera, where it sits.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.cameras.io.camera_info import pose_of
from semloc_jax.cameras.io.fields import intrinsics_of, load_yaml, numbers, perspective, read_text, resolution
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError

GROUND_KEYS = ("project_matrix", "scale_xy", "shift_xy")
_WIDTH_PX, _HEIGHT_PX, _PX_PER_M = 1200.0, 1600.0, 100.0
"""The top view of these tools: 12 m x 16 m, one pixel a centimetre."""
_REACH_PX = 480.0
"""Ground in front of a camera on which its pose is fitted."""
_TURNS = {"front": 0, "left": 1, "back": 2, "rear": 2, "right": 3}
_MOST_OFF = 0.03


def pose_of_homography(
    content: Mapping[str, Any], K: tuple[float, float, float, float], name: str, where: str
) -> Float[np.ndarray, "4 4"]:
    """Pose of the camera; the picture of its own ground is turned by a quarter for each camera counter-clockwise.

    Args:
        content: the values by key.
        K: fx, fy, cx, cy of the camera [px].
        name: front, left, back (rear) or right.
        where: for messages.

    Raises:
        SemlocError: the name tells no direction, or the homography is that of no camera above the ground.
    """
    turn = next((turns for word, turns in _TURNS.items() if word in name.lower()), None)
    if turn is None:
        raise SemlocError(
            f"{where}: has a project_matrix, and its name '{name}' tells no direction; expected front, left, back or "
            "right in the name of the file"
        )
    H = numbers(content["project_matrix"], (9,), f"{where} project_matrix").reshape(3, 3)
    scale = numbers(content.get("scale_xy", [1.0, 1.0]), (2,), f"{where} scale_xy")
    shift = numbers(content.get("shift_xy", [0.0, 0.0]), (2,), f"{where} shift_xy")
    across = _WIDTH_PX if turn % 2 == 0 else _HEIGHT_PX
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0.2, 0.8, 13) * across, np.linspace(0.3, 1.0, 8) * _REACH_PX))
    flat = np.stack([u, v, np.ones_like(u)]) if abs(np.linalg.det(H)) > 1e-12 else None
    if flat is None:
        raise SemlocError(f"{where}: project_matrix cannot be inverted; expected a homography")
    seen = np.linalg.inv(H) @ flat
    fx, fy, cx, cy = K[0] * scale[0], K[1] * scale[1], K[2] + shift[0], K[3] + shift[1]
    ray = np.stack([(seen[0] / seen[2] - cx) / fx, (seen[1] / seen[2] - cy) / fy], axis=1)
    place = np.column_stack([_on_ground(u, v, turn), np.zeros_like(u)])
    found, turned, moved = cv2.solvePnP(place, np.ascontiguousarray(ray), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    found, turned, moved = cv2.solvePnP(
        place, ray, np.eye(3), None, turned, moved, useExtrinsicGuess=True, flags=cv2.SOLVEPNP_ITERATIVE
    )
    off = np.abs(cv2.projectPoints(place, turned, moved, np.eye(3), None)[0][:, 0] - ray).mean()
    T_base_cam = np.eye(4)
    T_base_cam[:3, :3] = cv2.Rodrigues(turned)[0].T
    T_base_cam[:3, 3] = -(T_base_cam[:3, :3] @ moved[:, 0])
    if not found or off > _MOST_OFF or not 0.05 < T_base_cam[2, 3] < 5.0:
        raise SemlocError(
            f"{where}: project_matrix puts the camera {T_base_cam[2, 3]:.2f} m above the ground and is {off:.3f} off a "
            "rigid view; expected the homography from the undistorted picture to a ground of 1 cm a pixel"
        )
    return T_base_cam


def _on_ground(u: np.ndarray, v: np.ndarray, turn: int) -> np.ndarray:
    """Places (x, y) [m] of pixels of the ground of one camera, whose picture has the vehicle below it."""
    half = 0.5 * (_WIDTH_PX if turn % 2 == 0 else _HEIGHT_PX), 0.5 * (_HEIGHT_PX if turn % 2 == 0 else _WIDTH_PX)
    ahead, left = (half[1] - v) / _PX_PER_M, (half[0] - u) / _PX_PER_M
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[turn]
    return np.stack([cos * ahead - sin * left, sin * ahead + cos * left], axis=1)


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
