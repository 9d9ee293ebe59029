"""Drives on which something goes wrong, by name: what a localizer must notice and survive (room: simulation; host).

In: a Drive, the map it is localized in, the name of a fault. Out: FaultyDrive. What is drawn at random is seeded.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.datasets.base import Drive, Frame
from semloc_jax.datasets.sensors import GnssTrack, Imu, WheelOdometry
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.maps import MapElement, SemanticMap

MaskChange = Callable[[np.ndarray], np.ndarray]
Log = TypeVar("Log", GnssTrack, WheelOdometry, Imu, Trajectory)


@dataclass(frozen=True)
class FaultSizes:
    """How bad the faults are; the figures are those of the specification, the times are our choice.

    Args:
        begin_share: share of the drive after which a passing fault begins.
        short_s: how long the images are black or occluded, or the masks of another class table [s].
        odometry_s: how long the wheels are silent [s].
        dropout_s: how long no fixes come [s].
        outlier_share: share of the fixes that are wrong.
        outlier_m: by how much [m].
        fixes_until_s: how long fixes come before they stop for good [s].
        clock_s: how late the clock of wheels, inertial sensor and receiver is against the cameras [s].
        pitch_deg: by how much the calibration of the first camera looks too far up [deg].
        jump_m: how far the vehicle is carried away [m].
    """

    begin_share: float = 0.45
    short_s: float = 3.0
    odometry_s: float = 2.0
    dropout_s: float = 5.0
    outlier_share: float = 0.05
    outlier_m: float = 20.0
    fixes_until_s: float = 2.0
    clock_s: float = 0.05
    pitch_deg: float = 1.0
    jump_m: float = 30.0


@dataclass(frozen=True)
class FaultyDrive:
    """A drive with a fault.

    Args:
        name: of the fault.
        drive: the drive with the fault in it.
        semantic_map: the map to localize in.
        from_s: begin of the fault in the time of the drive [s].
        to_s: its end; that of the drive for one that lasts [s].
    """

    name: str
    drive: Drive
    semantic_map: SemanticMap
    from_s: float
    to_s: float


@dataclass(frozen=True)
class MaskedFrame(Frame):
    """A frame whose masks and images pass through a change."""

    change_mask: MaskChange = lambda mask: mask
    change_image: MaskChange = lambda image: image

    def image(self, camera: str) -> np.ndarray:
        """Changed colour image."""
        return self.change_image(super().image(camera))

    def mask(self, source: str, camera: str) -> np.ndarray:
        """Changed class ids."""
        return self.change_mask(super().mask(source, camera))


def with_fault(
    name: str, drive: Drive, semantic_map: SemanticMap, seed: int = 0, sizes: FaultSizes | None = None
) -> FaultyDrive:
    """The drive with one fault.

    Args:
        name: One of `FAULTS`.
        drive: The drive as it was.
        semantic_map: The map it is localized in.
        seed: Of what is drawn at random.
        sizes: None for the defaults.

    Raises:
        SemlocError: there is no such fault, or the drive has not what it takes away.
    """
    if name not in FAULTS:
        raise SemlocError(f"fault '{name}': not known; expected one of {', '.join(FAULTS)}")
    return FAULTS[name](_Maker(name, drive, semantic_map, sizes or FaultSizes(), np.random.default_rng(seed)))


@dataclass(frozen=True)
class _Maker:
    name: str
    drive: Drive
    semantic_map: SemanticMap
    sizes: FaultSizes
    rng: np.random.Generator

    @cached_property
    def begin_s(self) -> float:
        first, last = self.drive.frames[0].time_s, self.drive.frames[-1].time_s
        return first + self.sizes.begin_share * (last - first)

    @property
    def end_s(self) -> float:
        return self.drive.frames[-1].time_s

    def made(self, drive: Drive, from_s: float, to_s: float, semantic_map: SemanticMap | None = None) -> FaultyDrive:
        return FaultyDrive(self.name, drive, semantic_map or self.semantic_map, from_s, min(to_s, self.end_s))

    @property
    def gnss(self) -> GnssTrack:
        if self.drive.gnss is None:
            raise SemlocError(f"fault '{self.name}': drive {self.drive.name} has no satellite fixes to disturb")
        return self.drive.gnss

    @property
    def odometry(self) -> WheelOdometry:
        if self.drive.odometry is None:
            raise SemlocError(f"fault '{self.name}': drive {self.drive.name} has no wheel odometry to disturb")
        return self.drive.odometry


def _none(maker: _Maker) -> FaultyDrive:
    return maker.made(maker.drive, maker.begin_s, maker.begin_s)


def _gnss_dropout(maker: _Maker) -> FaultyDrive:
    end_s = maker.begin_s + maker.sizes.dropout_s
    is_kept = (maker.gnss.time_s < maker.begin_s) | (maker.gnss.time_s >= end_s)
    return maker.made(replace(maker.drive, gnss=_rows(maker.gnss, is_kept)), maker.begin_s, end_s)


def _gnss_outliers(maker: _Maker) -> FaultyDrive:
    fixes, sizes = maker.gnss, maker.sizes
    is_wrong = maker.rng.random(len(fixes.time_s)) < sizes.outlier_share
    angle = maker.rng.uniform(0.0, 2.0 * np.pi, len(fixes.time_s))
    shift = sizes.outlier_m * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    drive = replace(maker.drive, gnss=replace(fixes, p_enu=fixes.p_enu + is_wrong[:, None] * shift))
    return maker.made(drive, maker.drive.frames[0].time_s, maker.end_s)


def _no_gnss_after_start(maker: _Maker) -> FaultyDrive:
    from_s = maker.drive.frames[0].time_s + maker.sizes.fixes_until_s
    return maker.made(replace(maker.drive, gnss=_rows(maker.gnss, maker.gnss.time_s < from_s)), from_s, maker.end_s)


def _black_images(maker: _Maker) -> FaultyDrive:
    # A network that sees nothing says everywhere what it says most.
    return _seen_through(
        maker, lambda mask: np.full_like(mask, np.bincount(mask.ravel()).argmax()), lambda image: np.zeros_like(image)
    )


def _occlusion(maker: _Maker) -> FaultyDrive:
    blocked = maker.drive.class_ids.get("vehicle", 255)
    return _seen_through(maker, lambda mask: np.full_like(mask, blocked), lambda image: np.full_like(image, 90))


def _wrong_class_table(maker: _Maker) -> FaultyDrive:
    if not maker.drive.class_ids:
        raise SemlocError(f"fault '{maker.name}': drive {maker.drive.name} does not state its class ids")
    other = np.full(256, 255, np.uint8)
    for name, value in maker.drive.class_ids.items():
        other[value] = _CITYSCAPES.get(name, _CITYSCAPES["road"] if value else 255)
    return _seen_through(maker, lambda mask: other[mask], lambda image: image)


_CITYSCAPES = {
    **{"road": 0, "sidewalk": 1, "building": 2, "wall": 3, "pole": 5, "traffic_light": 6, "sign": 7},
    **{"vegetation": 8, "terrain": 9, "sky": 10, "vehicle": 13, "ego": 255},
}
"""Train ids of Cityscapes, where paint is road."""


def _no_odometry(maker: _Maker) -> FaultyDrive:
    odometry, end_s = maker.odometry, maker.begin_s + maker.sizes.odometry_s
    is_kept = (odometry.time_s < maker.begin_s) | (odometry.time_s >= end_s)
    return maker.made(replace(maker.drive, odometry=_rows(odometry, is_kept)), maker.begin_s, end_s)


def _time_offset(maker: _Maker) -> FaultyDrive:
    # The truth is that of the exposures: what a frame is off by is what the sensors make of it.
    late = {
        name: replace(log, time_s=log.time_s + maker.sizes.clock_s)
        for name in ("gnss", "odometry", "imu")
        if (log := getattr(maker.drive, name)) is not None
    }
    return maker.made(replace(maker.drive, **late), maker.drive.frames[0].time_s, maker.end_s)


def _camera_pitch(maker: _Maker) -> FaultyDrive:
    angle = np.deg2rad(maker.sizes.pitch_deg)
    turn = np.eye(4)
    turn[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]

    def bumped(rig: Rig) -> Rig:
        T_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
        T_base_cam[0] = T_base_cam[0] @ turn
        return Rig(rig.cameras, T_base_cam, rig.names)

    rig = bumped(maker.drive.rig)
    frames = tuple(
        replace(frame, rig=rig if frame.rig is maker.drive.rig else bumped(frame.rig)) for frame in maker.drive.frames
    )
    return maker.made(replace(maker.drive, rig=rig, frames=frames), frames[0].time_s, maker.end_s)


def _kidnapped(maker: _Maker) -> FaultyDrive:
    """A stretch of the way is cut out of frames, sensors and truth, and the clock is set back by the time it took."""
    odometry, from_s = maker.odometry, maker.begin_s
    times = np.array([frame.time_s for frame in maker.drive.frames])
    last = int(np.flatnonzero(times <= from_s)[-1])
    way = odometry.distance_m(times) - odometry.distance_m(times[last : last + 1])
    landed = np.flatnonzero(way >= maker.sizes.jump_m)
    if len(landed) == 0:
        raise SemlocError(
            f"fault 'kidnapped': drive {maker.drive.name} goes on for {way[-1]:.0f} m only; expected more than "
            f"{maker.sizes.jump_m:.0f} m"
        )
    first = int(landed[0])
    cut_s = times[first] - times[last + 1]
    frames = [*maker.drive.frames[: last + 1], *maker.drive.frames[first:]]
    frames = [replace(f, time_s=f.time_s - (cut_s if k > last else 0.0)) for k, f in enumerate(frames)]

    logs = {
        name: _without(log, float(times[last + 1]), float(times[first]))
        for name in ("gnss", "odometry", "imu", "truth")
        if (log := getattr(maker.drive, name)) is not None
    }
    drive = replace(maker.drive, frames=tuple(frames), **logs)
    landing_s = float(frames[last + 1].time_s)
    return FaultyDrive(maker.name, drive, maker.semantic_map, landing_s, landing_s)


def _without(log: Log, from_s: float, to_s: float) -> Log:
    """A log without a stretch of time, what follows set back to its begin."""
    is_before, is_after = log.time_s < from_s - 1e-9, log.time_s >= to_s - 1e-9
    kept = _rows(log, is_before | is_after)
    return replace(kept, time_s=np.where(kept.time_s >= to_s - 1e-9, kept.time_s - (to_s - from_s), kept.time_s))


def _off_map(maker: _Maker) -> FaultyDrive:
    """The map ends where the vehicle is when the fault begins: a plane across its way."""
    frame = min(maker.drive.frames, key=lambda f: abs(f.time_s - maker.begin_s))
    T = maker.drive.truth_at(frame)
    elements = [part for element in maker.semantic_map.elements if (part := _behind(element, T)) is not None]
    return maker.made(maker.drive, frame.time_s, maker.end_s, maker.semantic_map.with_elements(elements))


def _behind(element: MapElement, T_map_base: np.ndarray) -> MapElement | None:
    """The part of an element that lies behind a vehicle; areas and objects that reach over the plane are left out."""
    ahead_m = (element.points - T_map_base[:3, 3]) @ T_map_base[:3, 0]
    if (ahead_m <= 0.0).all():
        return element
    is_behind = np.flatnonzero(ahead_m <= 0.0)
    if element.closed or len(is_behind) < 2 or len(is_behind) != np.ptp(is_behind) + 1:
        return None
    return replace(element, points=element.points[is_behind])


def _seen_through(maker: _Maker, change_mask: MaskChange, change_image: MaskChange) -> FaultyDrive:
    """The drive with other masks and images for a short time."""
    end_s = maker.begin_s + maker.sizes.short_s
    frames = tuple(
        MaskedFrame(**_values(frame), change_mask=change_mask, change_image=change_image)
        if maker.begin_s <= frame.time_s < end_s
        else frame
        for frame in maker.drive.frames
    )
    return maker.made(replace(maker.drive, frames=frames), maker.begin_s, end_s)


def _values(frame: Frame) -> dict:
    return {field.name: getattr(frame, field.name) for field in fields(frame)}


def _rows(log: Log, is_kept: np.ndarray) -> Log:
    """A log with some of its samples."""
    columns = {field.name: getattr(log, field.name) for field in fields(log)}
    return replace(log, **{name: rows[is_kept] for name, rows in columns.items() if isinstance(rows, np.ndarray)})


FAULTS: dict[str, Callable[[_Maker], FaultyDrive]] = {
    "none": _none,
    "gnss_dropout": _gnss_dropout,
    "gnss_outliers": _gnss_outliers,
    "no_gnss_after_start": _no_gnss_after_start,
    "black_images": _black_images,
    "occlusion": _occlusion,
    "no_odometry": _no_odometry,
    "wrong_class_table": _wrong_class_table,
    "time_offset": _time_offset,
    "camera_pitch": _camera_pitch,
    "kidnapped": _kidnapped,
    "off_map": _off_map,
}
"""Faults by name; `none` is what the others are compared with."""
