"""Where a camera sits, from the homography that lays its undistorted picture on the ground (room: cameras; host).

In: the keys project_matrix, scale_xy and shift_xy of an OpenCV calibration, as surround-view tools write them.
Out: T_base_cam. The base frame lies on the ground below the middle of the top view, x to its upper border.
"""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.cameras.io.fields import numbers
from semloc_jax.errors import SemlocError

KEYS = ("project_matrix", "scale_xy", "shift_xy")
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
