"""A drive with a fault, and what makes one (room: simulation; host).

In: a Drive, the map it is localized in. Out: FaultyDrive; Maker, which every fault takes.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from semloc_jax.datasets.base import Drive, Frame
from semloc_jax.datasets.sensors import GnssTrack, Imu, WheelOdometry
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.maps import SemanticMap

Log = TypeVar("Log", GnssTrack, WheelOdometry, Imu, Trajectory)
MaskChange = Callable[[np.ndarray], np.ndarray]


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


@dataclass(frozen=True)
class Maker:
    """Everything that a fault may start from."""

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

    def whole(self, drive: Drive | None = None, semantic_map: SemanticMap | None = None) -> FaultyDrive:
        """The fault from the first frame of the drive to its last."""
        drive = drive or self.drive
        begin_s, end_s = drive.frames[0].time_s, drive.frames[-1].time_s
        return FaultyDrive(self.name, drive, semantic_map or self.semantic_map, begin_s, end_s)

    def with_log(self, name: str, **columns: np.ndarray) -> FaultyDrive:
        """The whole drive with other columns in its `gnss`, `odometry` or `imu`."""
        return self.whole(drive=replace(self.drive, **{name: replace(getattr(self, name), **columns)}))

    @property
    def truth(self) -> Trajectory:
        return self._needed(self.drive.truth, "truth to say where its way runs")

    @property
    def gnss(self) -> GnssTrack:
        return self._needed(self.drive.gnss, "satellite fixes to disturb")

    @property
    def odometry(self) -> WheelOdometry:
        return self._needed(self.drive.odometry, "wheel odometry to disturb")

    @property
    def imu(self) -> Imu:
        return self._needed(self.drive.imu, "inertial sensor to disturb")

    def _needed(self, log: Log | None, what: str) -> Log:
        if log is None:
            raise SemlocError(f"fault '{self.name}': drive {self.drive.name} has no {what}")
        return log


def seen_through(
    frames: tuple[Frame, ...], change_mask: MaskChange, change_image: MaskChange = lambda image: image
) -> tuple[Frame, ...]:
    """The frames with other masks and images."""
    return tuple(
        MaskedFrame(
            **{field.name: getattr(frame, field.name) for field in fields(frame)},
            change_mask=change_mask,
            change_image=change_image,
        )
        for frame in frames
    )


def log_rows(log: Log, is_kept: np.ndarray) -> Log:
    """A log with some of its samples."""
    columns: dict[str, Any] = {field.name: getattr(log, field.name) for field in fields(log)}
    return replace(log, **{name: rows[is_kept] for name, rows in columns.items() if isinstance(rows, np.ndarray)})


def with_late_sensors(drive: Drive, size_s: float) -> Drive:
    """The drive whose wheels, inertial sensor and receiver state a time later than that of its cameras."""
    logs = {name: log for name in ("gnss", "odometry", "imu") if (log := getattr(drive, name)) is not None}
    return replace(drive, **{name: replace(log, time_s=log.time_s + size_s) for name, log in logs.items()})
