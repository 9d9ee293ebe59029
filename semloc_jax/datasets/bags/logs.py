"""Sensor messages of ROS: fixes, odometry, inertial data, camera calibration (room: datasets; host).

In: decoded messages and where their sensor sits. Out: GnssTrack, WheelOdometry, Imu, cameras.
"""

import logging
from typing import Any

import numpy as np

from semloc_jax.cameras import Camera
from semloc_jax.cameras.io.camera_info import camera_from_info
from semloc_jax.datasets.sensors import GnssTrack, Imu, WheelOdometry
from semloc_jax.errors import SemlocError

_LOG = logging.getLogger(__name__)
_UNKNOWN_SIGMA_M = 3.0
"""Accuracy assumed of a receiver that does not state one; our choice."""
_UNKNOWN, _NO_FIX = 0, -1

Messages = list[tuple[float, Any]]
"""Times [s] and decoded messages."""


def gnss_from_fixes(fixes: Messages, T_base_antenna: np.ndarray | None) -> GnssTrack | None:
    """Fixes of sensor_msgs NavSatFix; messages without a fix are left out, None where no fix is left."""
    rows = []
    for time_s, fix in fixes:
        place = (fix.latitude, fix.longitude, fix.altitude if np.isfinite(fix.altitude) else 0.0)
        is_usable = fix.status.status > _NO_FIX and np.isfinite(place).all() and place[:2] != (0.0, 0.0)
        if is_usable and abs(place[0]) <= 90.0 and abs(place[1]) <= 180.0:
            rows.append((time_s, *place, *_sigma_m(fix)))
    if not rows:
        return None
    table = np.array(rows, dtype=np.float64)
    lever = tuple(T_base_antenna[:3, 3].tolist()) if T_base_antenna is not None else (0.0, 0.0, 0.0)
    return GnssTrack.from_wgs84(table[:, 0], table[:, 1:4], table[:, 4:7], lever)


def odometry_from_twists(twists: Messages, T_base_sensor: np.ndarray | None, where: str) -> WheelOdometry | None:
    """Speed and yaw rate of the twists of nav_msgs Odometry or geometry_msgs TwistStamped; None for fewer than two."""
    rows = []
    for time_s, message in twists:
        twist = message.twist.twist if hasattr(message.twist, "twist") else message.twist
        v = np.array([twist.linear.x, twist.linear.y, twist.linear.z], dtype=np.float64)
        w = np.array([twist.angular.x, twist.angular.y, twist.angular.z], dtype=np.float64)
        if T_base_sensor is not None:
            w = T_base_sensor[:3, :3] @ w
            v = T_base_sensor[:3, :3] @ v - np.cross(w, T_base_sensor[:3, 3])
        if np.isfinite([*v, *w]).all():
            rows.append((time_s, v[0], w[2]))
    if len(rows) < 2:
        return None
    table = np.array(rows)
    _, order = np.unique(table[:, 0], return_index=True)
    table = table[order]
    if len(table) < 2 or not np.any(table[:, 1:]):
        _LOG.warning("%s: every speed is zero; its twist is not used as odometry", where)
        return None
    return WheelOdometry(*np.ascontiguousarray(table.T))


def imu_from_messages(messages: Messages, T_base_imu: np.ndarray | None) -> Imu | None:
    """Rates and accelerations of sensor_msgs Imu along the axes of the vehicle; None where there are none."""
    if not messages:
        return None
    R = np.eye(3) if T_base_imu is None else T_base_imu[:3, :3]
    time_s = np.array([time for time, _ in messages])
    gyro = np.array([[getattr(m.angular_velocity, axis) for axis in "xyz"] for _, m in messages], dtype=np.float64)
    accel = np.array([[getattr(m.linear_acceleration, axis) for axis in "xyz"] for _, m in messages], dtype=np.float64)
    _, order = np.unique(time_s, return_index=True)
    return Imu(time_s[order], gyro[order] @ R.T, accel[order] @ R.T)


def camera_of(info: Any, is_rectified: bool, where: str) -> Camera:
    """The camera of a sensor_msgs CameraInfo; of rectified images the one of its P matrix.

    Raises:
        SemlocError: the message holds no calibration, or a distortion that is not supported.
    """
    K, D, P = (np.asarray(_either(info, name), dtype=np.float64).ravel() for name in "kdp")
    if not np.any(K):
        raise SemlocError(
            f"{where}: the CameraInfo is empty (K is zero); expected a calibrated camera; give --calib FILE"
        )
    content = {"width": int(info.width), "height": int(info.height), "K": K.tolist()}
    content |= {"distortion_model": str(info.distortion_model), "D": D.tolist()}
    if is_rectified and P.size == 12 and np.any(P):
        content |= {"K": P.reshape(3, 4)[:, :3].ravel().tolist(), "distortion_model": "", "D": []}
    return camera_from_info(content, where)


def _either(info: Any, name: str) -> Any:
    """A field of CameraInfo: capital in ROS 1, small in ROS 2."""
    return getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())


def _sigma_m(fix: Any) -> np.ndarray:
    variance = np.asarray(fix.position_covariance, dtype=np.float64).reshape(3, 3).diagonal()
    is_known = fix.position_covariance_type != _UNKNOWN and np.all(variance > 0.0) and np.isfinite(variance).all()
    return np.sqrt(variance) if is_known else np.array([1.0, 1.0, 2.0]) * _UNKNOWN_SIGMA_M
