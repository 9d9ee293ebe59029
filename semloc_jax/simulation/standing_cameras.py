"""Calibrations of the cameras that are wrong for a whole drive (room: simulation; host).

In: Maker, the size of a fault. Out: FaultyDrive.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.cameras.base import Camera
from semloc_jax.cameras.other_lenses import longer, wider, with_distortion
from semloc_jax.errors import SemlocError
from semloc_jax.simulation.faulty_drive import FaultyDrive, Maker


def with_rig(maker: Maker, change: Callable[[Rig], Rig]) -> FaultyDrive:
    """The drive with another calibration, that of the frames included."""
    rig = change(maker.drive.rig)
    frames = tuple(
        replace(frame, rig=rig if frame.rig is maker.drive.rig else change(frame.rig)) for frame in maker.drive.frames
    )
    return maker.whole(drive=replace(maker.drive, rig=rig, frames=frames))


def with_mounts(maker: Maker, change: Callable[[np.ndarray], None]) -> FaultyDrive:
    """The drive whose calibration has other `Ts_base_cam`, `float64[c 4 4]`, which `change` writes."""

    def moved(rig: Rig) -> Rig:
        Ts_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
        change(Ts_base_cam)
        return Rig(rig.cameras, Ts_base_cam, rig.names)

    return with_rig(maker, moved)


def turned(maker: Maker, size_deg: float, axis: int, which: slice = slice(None)) -> FaultyDrive:
    """Cameras turned about an axis of the vehicle: 0 roll, 1 pitch, 2 yaw."""
    angle, i, j = np.deg2rad(size_deg), (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)

    def turn_them(Ts_base_cam: np.ndarray) -> None:
        Ts_base_cam[which, :3, :3] = turn @ Ts_base_cam[which, :3, :3]

    return with_mounts(maker, turn_them)


def _last_turned(maker: Maker, size_deg: float, axis: int) -> FaultyDrive:
    if len(maker.drive.rig.names) < 2:
        raise SemlocError(f"fault '{maker.name}': drive {maker.drive.name} has one camera; expected several")
    return turned(maker, size_deg, axis, slice(-1, None))


def _shifted(maker: Maker, size_m: float, axis: int) -> FaultyDrive:
    def shift(Ts_base_cam: np.ndarray) -> None:
        Ts_base_cam[:, axis, 3] += size_m

    return with_mounts(maker, shift)


def _with_lenses(maker: Maker, change: Callable[[Camera], Camera]) -> FaultyDrive:
    return with_rig(maker, lambda rig: Rig(tuple(change(c) for c in rig.cameras), rig.T_base_cam, rig.names))


camera_yaw = partial(turned, axis=2)
"""All cameras are stated to look farther to the left than they do."""
camera_pitch_lasting = partial(turned, axis=1)
"""All cameras are stated to look lower than they do."""
camera_roll = partial(turned, axis=0)
"""All cameras are stated to be rolled."""
one_camera_yaw = partial(_last_turned, axis=2)
"""The last camera of several is turned to the left in its mount."""
one_camera_pitch = partial(_last_turned, axis=1)
"""The last camera of several is tilted in its mount."""
camera_ahead = partial(_shifted, axis=0)
"""All cameras are stated farther ahead than they are."""
camera_aside = partial(_shifted, axis=1)
"""All cameras are stated farther to the left than they are."""
camera_height = partial(_shifted, axis=2)
"""All cameras are stated higher than they are."""


def focal(maker: Maker, share: float) -> FaultyDrive:
    """The focal lengths are stated longer than they are."""
    return with_rig(maker, partial(longer, share=share))


def aspect(maker: Maker, share: float) -> FaultyDrive:
    """Only the horizontal focal length is wrong."""
    return with_rig(maker, partial(wider, share=share))


def principal_point(maker: Maker, size_px: float) -> FaultyDrive:
    """The calibration has the centre of the image too far to the right."""
    return _with_lenses(maker, lambda camera: camera.shifted(size_px, 0.0))


def principal_point_down(maker: Maker, size_px: float) -> FaultyDrive:
    """The calibration has the centre of the image too low."""
    return _with_lenses(maker, lambda camera: camera.shifted(0.0, size_px))


def distortion(maker: Maker, share: float) -> FaultyDrive:
    """The distortion of the lenses is stated smaller than it is; at a share of 2 it has the wrong sign."""

    def weaker(rig: Rig) -> Rig:
        other = with_distortion(rig, 1.0 - share)
        if other is None:
            raise SemlocError(f"fault '{maker.name}': the cameras of drive {maker.drive.name} have no distortion")
        return other

    return with_rig(maker, weaker)
