"""What says how a vehicle moved: wheels, cameras and inertial sensor, or both (room: localization; host).

In: a Drive, a choice, its cameras and masks. Out: the MotionLog of a Localizer, the speeds that a map is made of.
Cameras and inertial sensor become velocities, whose errors last for seconds: a fusion estimates them.
"""

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import cv2
import numpy as np

from semloc_jax.datasets import Drive, Frame
from semloc_jax.datasets.inertial import require_usable
from semloc_jax.datasets.sensors import WheelOdometry
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.inputs.mask_view import MaskSource, resized
from semloc_jax.localization.odometry import OdometryConfig, OdometryFrame, ScenerySource, VisualInertialOdometry
from semloc_jax.perception.class_table import ClassTable
from semloc_jax.perception.surround import PAINT
from semloc_jax.perception.tracks import Scenery

_LOG = logging.getLogger(__name__)

Motion = Literal["wheels", "vio", "both"]
MotionChoice = Literal["auto", "wheels", "vio", "both"]
_LEAST_CORNERS = 10
"""With fewer the velocity is that of the inertial sensor alone, which the fusion has itself."""
_MARGIN_PX = 8
"""Around traffic and the vehicle itself, in which no corner is taken: what is followed is more than a point."""
_SKY, _ROAD = ("sky",), ("road", "roads", "service_lane", "parking", "drivable")
"""Names in class tables."""


class SeenMotion(NamedTuple):
    """What cameras and inertial sensor said of a drive."""

    frames: tuple[OdometryFrame, ...]
    num_start: int
    """Frames of the start, which were known only at its end."""
    reason: str
    """Why there are none; empty where there are."""


def resolved(drive: Drive, choice: MotionChoice) -> Motion:
    """The choice for this drive: with `auto` wheels where they are, else the inertial sensor, with cameras where images
    are.

    Raises:
        SemlocError: the drive lacks what is asked for, or its inertial readings cannot be right.
    """
    has_imu = _has_forces(drive)
    if choice == "auto":
        choice = "vio" if drive.odometry is None and has_imu else "wheels"
        if choice == "wheels":
            return choice
    if choice in ("vio", "both") and not has_imu:
        others = "; use --motion wheels" if drive.odometry is not None else ""
        raise SemlocError(
            f"drive {drive.name}: has no inertial data (imu.csv with rates and forces), which --motion {choice} "
            f"needs{others}"
        )
    if choice in ("wheels", "both") and drive.odometry is None:
        raise SemlocError(f"drive {drive.name}: has no wheel odometry (wheel_odom.csv); use --motion vio or auto")
    if choice != "wheels":
        require_usable(drive.imu, f"drive {drive.name}")
    return choice


def resolved_without_map(drive: Drive, choice: MotionChoice, cameras: Sequence[str]) -> Motion:
    """The choice for a way without a map: with `auto` all that the drive has; the console says what that is.

    Raises:
        SemlocError: a camera is not in the calibration.
    """
    drive.rig.select(cameras)  # names what is not there
    if choice != "auto":
        return choice
    if not _has_forces(drive) or len(with_images(drive, cameras)) < len(cameras):
        lacks = "no inertial data" if not _has_forces(drive) else "no images"
        _LOG.info("motion: wheels; %s for --motion vio", lacks)
        return "wheels"
    chosen = "vio" if drive.odometry is None else "both"
    _LOG.info("motion: %scameras (%s), inertial sensor", "wheels, " if chosen == "both" else "", ", ".join(cameras))
    return chosen


def _has_forces(drive: Drive) -> bool:
    return drive.imu is not None and bool(np.abs(drive.imu.accel_mps2).any())


def motion_log(drive: Drive, motion: Motion, masks: MaskSource) -> MotionLog:
    """The log that a localizer takes; says on the console what it is made of.

    Args:
        drive: With what `motion` needs.
        motion: See `resolved`.
        masks: No corner is taken where they show traffic, sky or the vehicle; their cameras are followed.
    """
    log = MotionLog.of_drive(replace(drive, odometry=None) if motion == "vio" else drive)
    if motion == "wheels":
        said = "wheels" + (" and inertial sensor" if drive.imu is not None else "")
        _LOG.info("motion: %s", said if drive.odometry is not None else "nothing measures it: no wheels, no forces")
        return log
    wheels = "wheels, " if motion == "both" else ""
    cameras = with_images(drive, masks.cameras)
    if not cameras:
        _LOG.info("motion: %sinertial sensor; no images of %s", wheels, ", ".join(masks.cameras))
        return log
    try:
        seen = seen_motion(drive, cameras, masks, motion == "both")
    except SemlocError as error:  # a gap of the inertial sensor: between the others it helps all the same
        seen = SeenMotion((), 0, str(error))
    for frame in seen.frames:
        if frame.velocity is not None and frame.num_followed >= _LEAST_CORNERS:
            log.add_velocity(frame.time_s, frame.velocity)
    if seen.frames:
        first_s = seen.frames[seen.num_start - 1].time_s
        _LOG.info("motion: %scameras (%s) from %.1f s on, inertial sensor", wheels, ", ".join(cameras), first_s)
    else:
        _LOG.warning("motion: %sinertial sensor; cameras gave no start: %s", wheels, seen.reason)
    return log


def with_seen_speed(drive: Drive, masks: MaskSource, with_wheels: bool) -> Drive:
    """The drive with the speeds of cameras and inertial sensor in place of those of wheels, for a map of its own.

    Nothing is localized while it drives, so the frames of the start count too.

    Raises:
        SemlocError: the drive lacks images or inertial data, or no start was found.
    """
    cameras = with_images(drive, masks.cameras) or tuple(masks.cameras)
    seen = seen_motion(drive, cameras, masks, with_wheels)
    if not seen.frames:
        lacks = "" if drive.odometry is not None else "has no wheel odometry, and "
        raise SemlocError(f"drive {drive.name}: {lacks}cameras and inertial sensor gave no start: {seen.reason}")
    time_s = np.array([frame.time_s for frame in seen.frames])
    speed = np.array([frame.T_odom_base[:3, 0] @ frame.velocity_odom for frame in seen.frames])
    bias = np.array([frame.bias[2] for frame in seen.frames])
    imu = drive.imu
    inside = (imu.time_s >= time_s[0]) & (imu.time_s <= time_s[-1])
    at_s = np.unique(np.concatenate([time_s, imu.time_s[inside]]))
    rate = np.interp(at_s, imu.time_s, imu.gyro_radps[:, 2]) - np.interp(at_s, time_s, bias)
    _LOG.info("motion: cameras (%s) and inertial sensor", ", ".join(cameras))
    return replace(drive, odometry=WheelOdometry(at_s, np.interp(at_s, time_s, speed), rate))


def seen_motion(drive: Drive, cameras: Sequence[str], masks: MaskSource | None, with_wheels: bool) -> SeenMotion:
    """All frames of a drive by cameras and inertial sensor."""
    odometry = VisualInertialOdometry(drive, cameras, OdometryConfig(), with_wheels)
    scenery = None if masks is None else scenery_of(masks)
    found: list[OdometryFrame] = []
    num_start = 0
    for frame in odometry.frames:
        new = odometry.step(frame, scenery)
        num_start = num_start or len(new)
        found += new
    return SeenMotion(tuple(found), num_start, odometry.reason or "the drive is too short")


def with_images(drive: Drive, cameras: Sequence[str]) -> tuple[str, ...]:
    """Those of the cameras that have images."""
    return tuple(name for name in cameras if drive.frames and drive.frames[0].has("rgb", name))


def scenery_of(masks: MaskSource) -> ScenerySource:
    """Where masks show traffic, sky or the vehicle itself, and where the road, in the size of the image."""
    table = masks.table
    moving, sky, off_road = np.zeros(256, np.uint8), np.zeros(256, np.uint8), np.ones(256, np.uint8)
    moving[[*table.dynamic_ids, *table.ego_ids]], sky[_named(table, _SKY)] = 1, 1
    paint = [id_ for channel in table.channels if set(channel.classes) <= PAINT for id_ in channel.mask_ids]
    # Masks of paint alone do not say where the road is: what they call paint may be anything bright.
    named = _named(table, _ROAD)
    off_road[[*named, *(paint if named else ())]] = 0

    def scenery(frame: Frame, camera: str) -> Scenery:
        mask = masks.segment(frame, camera)
        dynamic = frame.dynamic_mask(camera)
        # A table of OpenCV: indexing an array by a picture makes indices of eight bytes a pixel first.
        carried, above, beside = (
            cv2.LUT(np.asarray(mask, np.uint8), ids).view(bool) for ids in (moving, sky, off_road)
        )
        if dynamic is not None:
            carried = carried | resized(dynamic, mask)
        width, height = frame.rig.cameras[frame.rig.index(camera)].resolution
        size = np.empty((height, width), np.uint8)
        carried, above, beside = (resized(part, size) for part in (carried, above, beside))
        near = cv2.dilate(carried.view(np.uint8), np.ones((2 * _MARGIN_PX + 1,) * 2, np.uint8)).view(bool)
        return Scenery(~(near | above), ~beside)

    return scenery


def _named(table: ClassTable, names: Sequence[str]) -> list[int]:
    return [id_ for id_, name in table.id_names.items() if name in names]
