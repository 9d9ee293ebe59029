"""Faults that last a whole drive, in three severities: a wrong map, calibration, masks or prior (room: simulation;
host).

In: Maker. Out: FaultyDrive. What is drawn at random is seeded.
A single frame must notice them by itself: it has no time in which they would show.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import equinox as eqx
import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.datasets.base import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.maps import MapElement
from semloc_jax.simulation.faulty_drive import FaultyDrive, Maker, MaskChange, seen_through
from semloc_jax.structs import ElementClass

NUM_SEVERITIES = 3
_LINES = (ElementClass.LANE_MARKING, ElementClass.STOP_LINE, ElementClass.ROAD_MARK, ElementClass.SLOT_LINE)
_UPRIGHT = (ElementClass.POLE, ElementClass.SIGN, ElementClass.TRAFFIC_LIGHT, ElementClass.PILLAR, ElementClass.CONE)


@dataclass(frozen=True)
class StandingFault:
    """One fault with its sizes.

    Args:
        make: the faulty drive of a maker and a size.
        sizes: of the severities 1, 2 and 3.
        unit: of the sizes.
    """

    make: Callable[[Maker, float], FaultyDrive]
    sizes: tuple[float, float, float]
    unit: str


def _whole(maker: Maker, **changed: object) -> FaultyDrive:
    """The drive with the fault from its first frame to its last."""
    drive = changed.pop("drive", maker.drive)
    return maker.made(drive, drive.frames[0].time_s, maker.end_s, **changed)


def _map_of(maker: Maker, change: Callable[[MapElement], MapElement | None]) -> FaultyDrive:
    kept = [new for element in maker.semantic_map.elements if (new := change(element)) is not None]
    return _whole(maker, semantic_map=maker.semantic_map.with_elements(kept))


def _moved(element: MapElement, shift_m: np.ndarray) -> MapElement:
    return element.with_points(element.points + np.append(shift_m, 0.0))


def _map_missing(maker: Maker, share: float) -> FaultyDrive:
    return _map_of(maker, lambda element: None if maker.rng.random() < share else element)


def _map_worn(maker: Maker, size_m: float) -> FaultyDrive:
    """Two fifths of the elements are missing, three tenths moved."""

    def worn(element: MapElement) -> MapElement | None:
        fate, shift_m = maker.rng.random(), size_m * maker.rng.normal(size=2)
        return None if fate < 0.4 else _moved(element, shift_m) if fate < 0.7 else element

    return _map_of(maker, worn)


def _map_scattered(maker: Maker, size_m: float) -> FaultyDrive:
    return _map_of(maker, lambda element: _moved(element, size_m * maker.rng.normal(size=2)))


def _across(maker: Maker, point: np.ndarray) -> np.ndarray:
    """Unit vector to the left of the way where it comes nearest to a place, float64[2]."""
    if maker.drive.truth is None:
        raise SemlocError(f"fault '{maker.name}': drive {maker.drive.name} has no truth to say where its way runs")
    way = maker.drive.truth.T_map_base
    near = int(np.argmin(np.hypot(*(way[:, :2, 3] - point[:2]).T)))
    return way[near, :2, 1] / np.linalg.norm(way[near, :2, 1])


def _moved_across(maker: Maker, labels: tuple[ElementClass, ...], size_m: float) -> FaultyDrive:
    def aside(element: MapElement) -> MapElement:
        if element.label not in labels:
            return element
        return _moved(element, size_m * _across(maker, element.points.mean(axis=0)))

    return _map_of(maker, aside)


def _repainted(maker: Maker, size_m: float) -> FaultyDrive:
    """All lines lie aside of where the map has them; what stands is where it was."""
    return _moved_across(maker, _LINES, size_m)


def _posts_aside(maker: Maker, size_m: float) -> FaultyDrive:
    return _moved_across(maker, _UPRIGHT, size_m)


def _dashes_along(maker: Maker, size_m: float) -> FaultyDrive:
    def along(element: MapElement) -> MapElement:
        if element.style != "dashed":
            return element
        left = _across(maker, element.points.mean(axis=0))
        return _moved(element, size_m * np.array([left[1], -left[0]]))

    return _map_of(maker, along)


def _map_mirrored(maker: Maker, share: float) -> FaultyDrive:
    """The map as in a mirror along the way; `share` of its elements, the others are missing."""
    way = maker.drive.truth.T_map_base if maker.drive.truth is not None else None
    if way is None:
        raise SemlocError(f"fault '{maker.name}': drive {maker.drive.name} has no truth to say where its way runs")

    def mirrored(element: MapElement) -> MapElement | None:
        if maker.rng.random() > share:
            return None
        middle = element.points.mean(axis=0)
        near = way[int(np.argmin(np.hypot(*(way[:, :2, 3] - middle[:2]).T)))]
        left = near[:2, 1] / np.linalg.norm(near[:2, 1])
        offset_m = (element.points[:, :2] - near[:2, 3]) @ left
        points = element.points.copy()
        points[:, :2] -= 2.0 * offset_m[:, None] * left
        # Mirrored outlines run the other way round.
        return element.with_points(points[::-1] if element.closed else points)

    return _map_of(maker, mirrored)


def _map_scaled(maker: Maker, share: float) -> FaultyDrive:
    middle = np.append(maker.semantic_map.extent[:, :2].mean(axis=0), 0.0)
    middle[:2] = maker.drive.truth_at(maker.drive.frames[0])[:2, 3] if maker.drive.truth is not None else middle[:2]
    scale = np.array([1.0 + share, 1.0 + share, 1.0])
    return _map_of(maker, lambda element: element.with_points(middle + scale * (element.points - middle)))


def _with_rig(maker: Maker, change: Callable[[Rig], Rig]) -> FaultyDrive:
    """The drive with another calibration, that of the frames included."""
    rig = change(maker.drive.rig)
    frames = tuple(
        replace(frame, rig=rig if frame.rig is maker.drive.rig else change(frame.rig)) for frame in maker.drive.frames
    )
    return _whole(maker, drive=replace(maker.drive, rig=rig, frames=frames))


def _turned(maker: Maker, axis: int, size_deg: float) -> FaultyDrive:
    """All cameras turned about an axis of the vehicle: 0 roll, 1 pitch, 2 yaw."""
    angle, i, j = np.deg2rad(size_deg), (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)

    def turned(rig: Rig) -> Rig:
        T_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
        T_base_cam[:, :3, :3] = turn @ T_base_cam[:, :3, :3]
        return Rig(rig.cameras, T_base_cam, rig.names)

    return _with_rig(maker, turned)


def _camera_yaw(maker: Maker, size_deg: float) -> FaultyDrive:
    return _turned(maker, 2, size_deg)


def _camera_pitch_lasting(maker: Maker, size_deg: float) -> FaultyDrive:
    return _turned(maker, 1, size_deg)


def _camera_roll(maker: Maker, size_deg: float) -> FaultyDrive:
    return _turned(maker, 0, size_deg)


def _camera_height(maker: Maker, size_m: float) -> FaultyDrive:
    def raised(rig: Rig) -> Rig:
        T_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
        T_base_cam[:, 2, 3] += size_m
        return Rig(rig.cameras, T_base_cam, rig.names)

    return _with_rig(maker, raised)


def _intrinsics(maker: Maker, change: Callable) -> FaultyDrive:
    return _with_rig(maker, lambda rig: eqx.tree_at(lambda r: r.cameras, rig, tuple(change(c) for c in rig.cameras)))


def _focal(maker: Maker, share: float) -> FaultyDrive:
    return _intrinsics(
        maker, lambda c: eqx.tree_at(lambda k: (k.fx, k.fy), c, ((1.0 + share) * c.fx, (1.0 + share) * c.fy))
    )


def _principal_point(maker: Maker, size_px: float) -> FaultyDrive:
    return _intrinsics(maker, lambda camera: camera.shifted(size_px, 0.0))


def _masks_through(maker: Maker, change: MaskChange) -> FaultyDrive:
    frames = seen_through(maker.drive.frames, change, change)
    return _whole(maker, drive=replace(maker.drive, frames=frames))


def _masks_mirrored(maker: Maker, share: float) -> FaultyDrive:
    """Left and right exchanged in a share of the frames, drawn at random."""
    mirrored = seen_through(maker.drive.frames, lambda m: m[:, ::-1].copy(), lambda m: m[:, ::-1].copy())
    drawn = maker.rng.random(len(mirrored)) < share
    frames = [new if d else old for new, old, d in zip(mirrored, maker.drive.frames, drawn, strict=True)]
    return _whole(maker, drive=replace(maker.drive, frames=tuple(frames)))


def _masks_shifted(maker: Maker, size_px: float) -> FaultyDrive:
    return _masks_through(maker, lambda mask: np.roll(mask, round(size_px), axis=1))


def _masks_lost(maker: Maker, share: float) -> FaultyDrive:
    """Columns of the image, a share of its width, show what is seen most."""

    def lost(mask: np.ndarray) -> np.ndarray:
        out = mask.copy()
        width = round(share * mask.shape[1])
        out[:, (mask.shape[1] - width) // 2 :][:, :width] = np.bincount(mask.ravel()).argmax() if mask.ndim == 2 else 0
        return out

    return _masks_through(maker, lost)


def _own_lane_only(maker: Maker, share: float) -> FaultyDrive:
    """A traffic jam: beside the middle `share` of the image all is vehicles."""
    blocked = maker.drive.class_ids.get("vehicle", 255)

    def jam(mask: np.ndarray) -> np.ndarray:
        out = mask.copy()
        side = round(0.5 * (1.0 - share) * mask.shape[1])
        out[:, :side] = out[:, mask.shape[1] - side :] = blocked
        return out

    return _masks_through(maker, jam)


def _masks_thin(maker: Maker, size_px: float) -> FaultyDrive:
    """Every class loses its border to its surroundings."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(size_px) + 1,) * 2)

    def thin(mask: np.ndarray) -> np.ndarray:
        if mask.ndim != 2:
            return mask
        ground = np.bincount(mask.ravel()).argmax()
        inside = cv2.erode((mask != ground).astype(np.uint8), kernel) > 0
        return np.where(inside, mask, ground).astype(mask.dtype)

    return _masks_through(maker, thin)


def _other_masks(maker: Maker, share: float) -> FaultyDrive:
    """Every frame has the masks and images of the one a share of the drive later, around the end to the begin."""
    frames, step = maker.drive.frames, max(round(share * len(maker.drive.frames)), 1)
    swapped = tuple(_OtherFrame.of(frame, frames[(k + step) % len(frames)]) for k, frame in enumerate(frames))
    return _whole(maker, drive=replace(maker.drive, frames=swapped))


@dataclass(frozen=True)
class _OtherFrame(Frame):
    """A frame that shows what another one saw."""

    shown: Frame | None = None

    @classmethod
    def of(cls, frame: Frame, shown: Frame) -> "_OtherFrame":
        values = {name: getattr(frame, name) for name in Frame.__dataclass_fields__}
        return cls(**values, shown=shown)

    def image(self, camera: str) -> np.ndarray:
        """Image of the other frame."""
        return self.shown.image(camera)

    def mask(self, source: str, camera: str) -> np.ndarray:
        """Class ids of the other frame."""
        return self.shown.mask(source, camera)


def _fixes_moved(maker: Maker, ahead_m: float, left_m: float, sigma_m: float | None = None) -> FaultyDrive:
    fixes = maker.gnss
    if maker.drive.truth is None:
        raise SemlocError(f"fault '{maker.name}': drive {maker.drive.name} has no truth to say where its way runs")
    truth = maker.drive.truth
    inside = (fixes.time_s >= truth.time_s[0]) & (fixes.time_s <= truth.time_s[-1])
    T = truth.interpolate(np.clip(fixes.time_s, truth.time_s[0], truth.time_s[-1]))
    shift = inside[:, None] * (ahead_m * T[:, :3, 0] + left_m * T[:, :3, 1])
    sigma = fixes.sigma_m if sigma_m is None else np.full_like(fixes.sigma_m, sigma_m)
    return _whole(maker, drive=replace(maker.drive, gnss=replace(fixes, p_enu=fixes.p_enu + shift, sigma_m=sigma)))


def _fixes_left(maker: Maker, size_m: float) -> FaultyDrive:
    return _fixes_moved(maker, 0.0, size_m)


def _fixes_along(maker: Maker, size_m: float) -> FaultyDrive:
    return _fixes_moved(maker, size_m, 0.0)


def _fixes_too_sure(maker: Maker, size_m: float) -> FaultyDrive:
    """Fixes that are off to the left and ahead and state 0.1 m."""
    return _fixes_moved(maker, size_m / np.sqrt(2.0), size_m / np.sqrt(2.0), 0.1)


STANDING: dict[str, StandingFault] = {
    "map_missing": StandingFault(_map_missing, (0.2, 0.4, 0.7), "share of its elements"),
    "map_worn": StandingFault(_map_worn, (0.5, 1.0, 2.0), "m"),
    "map_scattered": StandingFault(_map_scattered, (0.3, 1.0, 3.0), "m"),
    "map_mirrored": StandingFault(_map_mirrored, (1.0, 0.7, 0.4), "share of its elements"),
    "map_scaled": StandingFault(_map_scaled, (0.01, 0.03, 0.1), "share"),
    "lines_repainted": StandingFault(_repainted, (0.3, 0.5, 1.0), "m"),
    "posts_aside": StandingFault(_posts_aside, (0.5, 1.0, 2.0), "m"),
    "dashes_along": StandingFault(_dashes_along, (1.0, 2.0, 4.5), "m"),
    "camera_yaw": StandingFault(_camera_yaw, (0.5, 1.0, 2.0), "deg"),
    "camera_pitch_lasting": StandingFault(_camera_pitch_lasting, (0.5, 1.0, 2.0), "deg"),
    "camera_roll": StandingFault(_camera_roll, (1.0, 2.0, 4.0), "deg"),
    "camera_height": StandingFault(_camera_height, (0.1, 0.2, 0.4), "m"),
    "focal": StandingFault(_focal, (0.02, 0.05, 0.1), "share"),
    "principal_point": StandingFault(_principal_point, (4.0, 12.0, 30.0), "px"),
    "masks_mirrored": StandingFault(_masks_mirrored, (0.3, 0.6, 1.0), "share of the frames"),
    "masks_shifted": StandingFault(_masks_shifted, (4.0, 12.0, 30.0), "px"),
    "masks_lost": StandingFault(_masks_lost, (0.3, 0.6, 0.9), "share of the width"),
    "masks_thin": StandingFault(_masks_thin, (1.0, 2.0, 3.0), "px"),
    "own_lane_only": StandingFault(_own_lane_only, (0.5, 0.35, 0.2), "share of the width"),
    "other_masks": StandingFault(_other_masks, (0.02, 0.2, 0.5), "share of the drive"),
    "fixes_left": StandingFault(_fixes_left, (1.75, 3.5, 7.0), "m"),
    "fixes_along": StandingFault(_fixes_along, (4.0, 8.0, 18.0), "m"),
    "fixes_too_sure": StandingFault(_fixes_too_sure, (1.0, 2.0, 4.0), "m"),
}
"""Faults by name."""


def standing_fault(maker: Maker, name: str, severity: int) -> FaultyDrive:
    """The drive with one of `STANDING` in a severity of 1, 2 or 3.

    Raises:
        SemlocError: there is no such severity, or the drive has not what the fault changes.
    """
    if severity not in range(1, NUM_SEVERITIES + 1):
        raise SemlocError(f"fault '{name}': severity {severity}; expected 1 to {NUM_SEVERITIES}, as in {name}:2")
    fault = STANDING[name]
    return fault.make(maker, fault.sizes[severity - 1])
