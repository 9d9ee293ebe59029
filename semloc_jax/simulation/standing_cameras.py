"""Calibrations of the cameras that are wrong for a whole drive (room: simulation; host).

In: Maker, the size of a fault. Out: FaultyDrive.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import equinox as eqx
import numpy as np

from semloc_jax.cameras import Rig
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


def _turn(axis: int, size_deg: float) -> np.ndarray:
    """Rotation about an axis of the vehicle, float64[3 3]."""
    angle, i, j = np.deg2rad(size_deg), (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
    return turn


def turned(maker: Maker, axis: int, size_deg: float) -> FaultyDrive:
    """All cameras turned about an axis of the vehicle: 0 roll, 1 pitch, 2 yaw."""
    turn = _turn(axis, size_deg)

    def turned_rig(rig: Rig) -> Rig:
        T_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
        T_base_cam[:, :3, :3] = turn @ T_base_cam[:, :3, :3]
        return Rig(rig.cameras, T_base_cam, rig.names)

    return with_rig(maker, turned_rig)


def camera_yaw(maker: Maker, size_deg: float) -> FaultyDrive:
    """All cameras are stated to look farther to the left than they do."""
    return turned(maker, 2, size_deg)


def camera_pitch_lasting(maker: Maker, size_deg: float) -> FaultyDrive:
    """All cameras are stated to look lower than they do."""
    return turned(maker, 1, size_deg)


def camera_roll(maker: Maker, size_deg: float) -> FaultyDrive:
    """All cameras are stated to be rolled."""
    return turned(maker, 0, size_deg)


def camera_height(maker: Maker, size_m: float) -> FaultyDrive:
    """All cameras are stated higher than they are."""

    def raised(rig: Rig) -> Rig:
        T_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
        T_base_cam[:, 2, 3] += size_m
        return Rig(rig.cameras, T_base_cam, rig.names)

    return with_rig(maker, raised)


def intrinsics(maker: Maker, change: Callable) -> FaultyDrive:
    """The drive with other lenses."""
    return with_rig(maker, lambda rig: eqx.tree_at(lambda r: r.cameras, rig, tuple(change(c) for c in rig.cameras)))


def focal(maker: Maker, share: float) -> FaultyDrive:
    """The focal lengths are stated longer than they are."""
    return with_rig(maker, partial(longer, share=share))


def principal_point(maker: Maker, size_px: float) -> FaultyDrive:
    """The calibration has the centre of the image too far to the right."""
    return intrinsics(maker, lambda camera: camera.shifted(size_px, 0.0))


def principal_point_down(maker: Maker, size_px: float) -> FaultyDrive:
    """The calibration has the centre of the image too low."""
    return intrinsics(maker, lambda camera: camera.shifted(0.0, size_px))


def aspect(maker: Maker, share: float) -> FaultyDrive:
    """Only the horizontal focal length is wrong."""
    return with_rig(maker, partial(wider, share=share))


def distortion(maker: Maker, share: float) -> FaultyDrive:
    """The distortion of the lenses is stated smaller than it is; at a share of 2 it has the wrong sign."""

    def weaker(rig: Rig) -> Rig:
        other = with_distortion(rig, 1.0 - share)
        if other is None:
            raise SemlocError(f"fault '{maker.name}': the cameras of drive {maker.drive.name} have no distortion")
        return other

    return with_rig(maker, weaker)


def _mounted(maker: Maker, axis: int, size_m: float) -> FaultyDrive:
    def shifted(rig: Rig) -> Rig:
        T_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
        T_base_cam[:, axis, 3] += size_m
        return Rig(rig.cameras, T_base_cam, rig.names)

    return with_rig(maker, shifted)


def camera_ahead(maker: Maker, size_m: float) -> FaultyDrive:
    """All cameras are stated farther ahead than they are."""
    return _mounted(maker, 0, size_m)


def camera_aside(maker: Maker, size_m: float) -> FaultyDrive:
    """All cameras are stated farther to the left than they are."""
    return _mounted(maker, 1, size_m)


def one_camera_yaw(maker: Maker, size_deg: float) -> FaultyDrive:
    """The last camera of several is turned to the left in its mount."""
    return _one_turned(maker, 2, size_deg)


def one_camera_pitch(maker: Maker, size_deg: float) -> FaultyDrive:
    """The last camera of several is tilted in its mount."""
    return _one_turned(maker, 1, size_deg)


def _one_turned(maker: Maker, axis: int, size_deg: float) -> FaultyDrive:
    if len(maker.drive.rig.names) < 2:
        raise SemlocError(f"fault '{maker.name}': drive {maker.drive.name} has one camera; expected several")
    turn = _turn(axis, size_deg)

    def turned_last(rig: Rig) -> Rig:
        T_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
        T_base_cam[-1, :3, :3] = turn @ T_base_cam[-1, :3, :3]
        return Rig(rig.cameras, T_base_cam, rig.names)

    return with_rig(maker, turned_last)
