"""What looks wrong in a calibration, before anything is localized with it (room: cameras; host).

In: Rig and the sizes of its pictures. Out: findings as text. All limits are our choice: they fit cars, vans and trucks.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from semloc_jax.cameras.base import Camera
from semloc_jax.cameras.bev import BevCamera
from semloc_jax.cameras.cylinder import CylindricalCamera
from semloc_jax.cameras.rig import Rig
from semloc_jax.geometry.rigid import inverse

_HEIGHT_M = (0.15, 4.5)
_REACH_M = (15.0, 3.0)
_VIEW_DEG = (8.0, 150.0)
_FISHEYE_VIEW_DEG = (60.0, 260.0)
_OFF_CENTRE = 0.12
_SIDES = {"left": (0.0, 1.0), "right": (0.0, -1.0), "rear": (-1.0, 0.0), "back": (-1.0, 0.0), "front": (1.0, 0.0)}
_FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Finding:
    """One thing that looks wrong.

    Args:
        camera: name of the camera.
        kind: height, axes, size, angles or lens.
        text: what was found, what is usual, what to do.
    """

    camera: str
    kind: str
    text: str

    def __str__(self) -> str:
        return f"{self.camera}: {self.text}"


def implausible(rig: Rig, image_sizes_px: Mapping[str, tuple[int, int]] | None = None) -> list[Finding]:
    """What looks wrong in a rig; empty for one that may be right.

    Args:
        rig: Cameras and where they sit.
        image_sizes_px: (width, height) of the pictures of each camera, where there are pictures.
    """
    found = []
    for name, camera, T in zip(rig.names, rig.cameras, np.asarray(rig.T_base_cam, dtype=np.float64), strict=True):
        if isinstance(camera, BevCamera):
            continue
        texts = [("height", text) for text in _height(T)]
        if not _is_absent(T):
            texts += [("axes", text) for text in _axes(T)]
            texts += [("axes", text) for text in _side(name, T)]
        texts += [("size", text) for text in _size(camera, (image_sizes_px or {}).get(name))]
        texts += [("angles", text) for text in _angles(camera)]
        texts += [("lens", text) for text in _lens(camera)]
        found += [Finding(name, kind, text) for kind, text in texts]
    return found + _all_ahead(rig) + _same_place(rig)


def view_angles_deg(T_base_cam: Float[np.ndarray, "4 4"]) -> tuple[float, float, float]:
    """Where a camera looks: yaw to the left, pitch down, roll clockwise as it sees it [deg]."""
    right, down, ahead = T_base_cam[:3, :3].T
    yaw = np.degrees(np.arctan2(ahead[1], ahead[0]))
    pitch = np.degrees(np.arcsin(np.clip(-ahead[2], -1.0, 1.0)))
    roll = np.degrees(np.arctan2(-right[2], -down[2]))
    return float(yaw), float(pitch), float(roll)


def _is_absent(T: np.ndarray) -> bool:
    return bool(np.allclose(T, np.eye(4), atol=1e-9))


def _height(T: np.ndarray) -> list[str]:
    height = float(T[2, 3])
    if _is_absent(T):
        return [
            "has no place on the vehicle (T_base_cam is the identity); add T_base_cam, camera to rear axle on ground"
        ]
    if np.allclose(T[:3, 3], 0.0, atol=1e-9):
        return [
            "sits at the origin of the base frame; expected its place above the road (rear axle on the ground is the "
            "origin); are the extrinsics relative to this camera or an IMU?"
        ]
    if height < 0.0:
        return [
            f"sits {-height:.2f} m under the ground; expected {_HEIGHT_M[0]} to {_HEIGHT_M[1]} m above it; z of the "
            "base frame points up and its origin is on the road; is the matrix T_cam_base, or the origin on the roof?"
        ]
    if height < _HEIGHT_M[0]:
        return [
            f"sits {height:.2f} m above the ground; expected at least {_HEIGHT_M[0]} m; is the base frame at the "
            "height of the axle, the IMU or the lidar instead of on the road?"
        ]
    if height > _HEIGHT_M[1] or abs(T[0, 3]) > _REACH_M[0] or abs(T[1, 3]) > _REACH_M[1]:
        return [
            f"sits at x {T[0, 3]:.1f}, y {T[1, 3]:.1f}, z {height:.1f} m; expected a place on a vehicle; are the units "
            "metres, and is the base frame that of the vehicle?"
        ]
    return []


def _axes(T: np.ndarray) -> list[str]:
    yaw, pitch, roll = view_angles_deg(T)
    if abs(pitch) < 80.0 and abs(roll) < 45.0 and pitch > -45.0:
        return []
    state = f"looks {abs(pitch):.0f} deg {'down' if pitch > 0 else 'up'}, rolled by {roll:.0f} deg, {yaw:.0f} deg left"
    if _looks_level(inverse(T)):
        return [f"{state}; its inverse looks level: the matrix is T_cam_base; invert it"]
    # A frame with x ahead, y left, z up where x right, y down, z ahead is meant.
    for columns in (_FROM_VEHICLE_AXES, _FROM_VEHICLE_AXES.T):
        if _looks_level(T @ columns):
            return [
                f"{state}; with x ahead, y left, z up as axes of the camera it looks level: T_base_cam wants x right, "
                "y down, z forward (the optical frame); multiply the rotation by that change of axes"
            ]
    if abs(roll) > 135.0 and abs(pitch) < 60.0:
        return [
            f"{state}: upside down; flip two axes (y and z are mirrored in the vehicle frame?) or turn the pictures"
        ]
    return [f"{state}; expected an upright camera; mirrored or swapped axes, or degrees where radians were meant"]


_FROM_VEHICLE_AXES = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0, 0, 0, 1.0]])


def _looks_level(T: np.ndarray) -> bool:
    _, pitch, roll = view_angles_deg(T)
    return bool(-15.0 < pitch < 60.0 and abs(roll) < 20.0 and T[2, 3] > -0.01)


def _side(name: str, T: np.ndarray) -> list[str]:
    """A camera named for one side that looks to the other."""
    words = [word for word in _SIDES if word in name.lower()]
    if not words:
        return []
    wanted = np.sum([_SIDES[word] for word in words], axis=0)
    ahead = T[:2, 2]
    if np.linalg.norm(ahead) < 0.2 or np.linalg.norm(wanted) < 0.5:
        return []
    cosine = float(ahead @ wanted / np.linalg.norm(ahead) / np.linalg.norm(wanted))
    yaw = view_angles_deg(T)[0]
    if cosine < -0.5:
        return [
            f"looks {yaw:.0f} deg to the left, away from what its name says; an axis is mirrored (y is left, x is "
            "forward), or two cameras are exchanged"
        ]
    across = T[1, 3] * wanted[1]
    if abs(wanted[1]) > 0.5 and across < -0.3:
        return [f"sits at y {T[1, 3]:.2f} m; expected the other side for its name; y of the base frame points left"]
    return []


def _size(camera: Camera, image_px: tuple[int, int] | None) -> list[str]:
    width, height = camera.resolution
    found = []
    if image_px is not None and tuple(image_px) != (width, height):
        found.append(
            f"pictures are {image_px[0]}x{image_px[1]} px, the calibration is for {width}x{height} px; calibrate at "
            "the size of the pictures or resize the camera (Camera.resized)"
        )
    if isinstance(camera, CylindricalCamera):
        return found
    rx, ry = 2.0 * float(camera.cx) / max(width - 1, 1), 2.0 * float(camera.cy) / max(height - 1, 1)
    if abs(rx - 1.0) > 2 * _OFF_CENTRE and abs(ry - 1.0) > 2 * _OFF_CENTRE and abs(rx - ry) < 0.15 * max(rx, ry):
        found.append(
            f"principal point ({float(camera.cx):.0f}, {float(camera.cy):.0f}) of {width}x{height} px; it is central "
            f"in pictures of about {width * rx:.0f}x{height * ry:.0f} px: fx fy cx cy belong to another size"
        )
    elif abs(rx - 1.0) > 2 * _OFF_CENTRE or abs(ry - 1.0) > 2 * _OFF_CENTRE:
        found.append(
            f"principal point ({float(camera.cx):.0f}, {float(camera.cy):.0f}) is far from the middle of {width}x"
            f"{height} px; are the pictures cropped, or cx and cy exchanged?"
        )
    ratio = float(camera.fx) / float(camera.fy)
    if not 0.9 < ratio < 1.1:
        found.append(f"fx / fy is {ratio:.2f}; expected about 1; are the pictures stretched, or the numbers in order?")
    return found


def _angles(camera: Camera) -> list[str]:
    for name in ("max_theta_rad", "max_phi_rad"):
        if hasattr(camera, name) and float(getattr(camera, name)) > np.pi + 1e-6:
            value = float(getattr(camera, name))
            return [f"{name} is {value:.4g}; expected at most 3.14; given in degrees? use {np.radians(value):.4g}"]
    return []


def _lens(camera: Camera) -> list[str]:
    width, height = camera.resolution
    middle = 0.5 * (height - 1)
    ray, valid = (np.asarray(a) for a in camera.unproject(np.array([[0.0, middle], [width - 1.0, middle]])))
    found = []
    if valid.all():
        turn = [np.arctan2(x, z) for x, _, z in ray]
        view_deg = float(np.degrees((turn[1] - turn[0]) % _FULL_TURN))
        is_wide = hasattr(camera, "max_theta_rad")
        low, high = _FISHEYE_VIEW_DEG if is_wide else _VIEW_DEG
        if not isinstance(camera, CylindricalCamera) and not low <= view_deg <= high:
            found.append(
                f"sees {view_deg:.0f} deg across; expected {low:.0f} to {high:.0f} deg; are fx and fy in pixels of "
                f"{width}x{height}, and is the lens model right?"
            )
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 25), np.linspace(0, height - 1, 17)), axis=-1)
    share = float(np.mean(np.asarray(camera.unproject(grid.reshape(-1, 2))[1])))
    if share < 0.75:
        found.append(
            f"the distortion can be undone in {share:.0%} of the picture only; expected nearly all; check the order of "
            "the coefficients (k1 k2 p1 p2 k3, or k1 k2 k3 k4 of a fisheye) and their size"
        )
    return found


def _all_ahead(rig: Rig) -> list[Finding]:
    """Cameras named for different sides that all look ahead: angles in radians where degrees were meant."""
    named = [name for name in rig.names if any(word in name.lower() for word in ("left", "right", "rear", "back"))]
    if len(named) < 2:
        return []
    yaws = [view_angles_deg(np.asarray(rig.T_base_cam[rig.index(name)]))[0] for name in named]
    if np.abs(yaws).max() > 4.0 or any(_is_absent(np.asarray(T)) for T in rig.T_base_cam):
        return []
    text = (
        f"and {', '.join(named[1:])} all look ahead within {np.abs(yaws).max():.1f} deg; expected different sides: "
        "their angles are radians where degrees were meant, or the rotations are missing"
    )
    return [Finding(named[0], "angles", text)]


def _same_place(rig: Rig) -> list[Finding]:
    found = []
    for i in range(len(rig)):
        for j in range(i):
            is_same = np.allclose(rig.T_base_cam[i], rig.T_base_cam[j], atol=1e-6)
            if is_same and not _is_absent(np.asarray(rig.T_base_cam[i])):
                text = f"has the very place and direction of {rig.names[j]}; expected its own; are extrinsics missing?"
                found.append(Finding(rig.names[i], "axes", text))
    return found
