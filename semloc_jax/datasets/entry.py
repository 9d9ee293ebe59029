"""What is checked once, where a recording enters: names, order, units (room: datasets; host).

In: a Drive as its reader made it. Out: the same drive, without frames that cannot be used; or the sentence that helps.
A wrong unit or axis localizes without an error and metres off; here two sensors that must agree are compared instead.
"""

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from semloc_jax.datasets.base import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.storage import FARTHEST_M, is_plain_name

_LOG = logging.getLogger(__name__)
_WINDOW_M = 15.0
"""Fixes this far apart tell a speed and a course although each of them jitters by metres; ours."""
_LONGEST_WINDOW_S = 20.0
_MIN_WINDOWS = 5
_SPEED_RATIO = (0.6, 1.6)
"""Between the speeds of two sensors that agree; the smallest confusion of units is a factor of 2.2; ours."""
_SPEED_UNITS = {
    3.6: "km/h",
    2.237: "mph",
    3.281: "ft/s",
    100.0: "cm/s",
    1000.0: "mm/s",
    1.0 / 3.6: "m/s twice scaled",
}
_TURN_RATIO = (0.3, 3.0)
_MIN_TURN_RAD = 0.5
"""Root of the summed squares of the turns that a comparison needs."""
_MIN_CORRELATION = 0.8
_FASTEST_TURN_RADPS, _LARGEST_SIDE_MPS2 = 12.0, 30.0
"""No road vehicle turns faster or takes a curve so fast for long."""


def checked(drive: Drive) -> Drive:
    """The drive, fit for use.

    Raises:
        SemlocError: a name of a camera leads out of its folder, no frame is usable, or a sensor has the wrong unit.
    """
    for name in drive.rig.names:
        if not is_plain_name(name):
            raise SemlocError(
                f"drive {drive.name}: camera name {name[:60]!r}; expected one that can name a folder; rename the camera"
            )
    if drive.truth is not None:
        known = np.isfinite(drive.truth.time_s) & (np.abs(drive.truth.T_map_base) <= FARTHEST_M).all(axis=(1, 2))
        if not known.all():
            raise SemlocError(
                f"drive {drive.name}: pose {int(np.argmin(known))} of its truth has a time or place that is no number "
                "or beyond the earth; expected seconds and metres; drop such rows"
            )
    frames = usable_frames(drive.frames, f"drive {drive.name}")
    drive = drive if frames == drive.frames else replace(drive, frames=frames)
    check_units(drive)
    return drive


def usable_frames(frames: Sequence[Frame], where: str) -> tuple[Frame, ...]:
    """The frames with a name and a time of their own, in the order of time; each other one costs itself only, and one
    line of notice.

    Raises:
        SemlocError: none is left.
    """
    copies = Counter(frame.id for frame in frames)
    times = Counter(frame.time_s for frame in frames)
    kept, reasons = [], []
    for frame in frames:
        reason = _reason(frame, copies, times)
        if reason is None:
            kept.append(frame)
        else:
            reasons.append(f"{where}: frame {frame.id[:60]!r} is left out: {reason}")
    for line in reasons[:5]:
        _LOG.warning("%s", line)
    if len(reasons) > 5:
        _LOG.warning("%s: and %d more frames like these", where, len(reasons) - 5)
    if not kept:
        raise SemlocError(f"{reasons[0] if reasons else where + ': has no frame'}; no other is left; repair the list")
    in_order = sorted(kept, key=lambda frame: frame.time_s)
    if in_order != kept:
        first = next(frame for frame, other in zip(kept, in_order, strict=True) if frame is not other)
        _LOG.warning("%s: frame %r is listed before an earlier one; frames are taken by time", where, first.id[:60])
    return tuple(in_order)


def _reason(frame: Frame, copies: Counter, times: Counter) -> str | None:
    if not np.isfinite(frame.time_s):
        return f"its time is {frame.time_s}"
    if not is_plain_name(frame.id):
        return "its name is no name of a file"
    if copies[frame.id] > 1:
        return f"{copies[frame.id]} frames have this name, and one image cannot be of several times"
    if times[frame.time_s] > 1:
        return f"{times[frame.time_s]} frames are of {frame.time_s:.3f} s"
    return None


def check_units(drive: Drive) -> None:
    """Compare speed and yaw rate of the sensors with the path of the fixes, else of the truth.

    Raises:
        SemlocError: they differ by what a wrong unit, sign or axis makes.
    """
    odometry, imu = drive.odometry, drive.imu
    if odometry is not None:
        _check_size(drive.name, "wheel odometry", odometry.yaw_rate_radps, odometry.speed_mps)
    if imu is not None:
        _check_size(drive.name, "imu", imu.gyro_radps[:, 2], None)
    path = _path(drive)
    if path is None:
        return
    time_s, xy = path
    start, end = _windows(time_s, xy)
    if len(start) < _MIN_WINDOWS:
        return
    if odometry is not None:
        inside = (time_s[start] >= odometry.time_s[0]) & (time_s[end] <= odometry.time_s[-1])
        a, b = start[inside], end[inside]
        driven_m = odometry.distance_m(time_s[b]) - odometry.distance_m(time_s[a])
        _check_speed(drive.name, driven_m, np.linalg.norm(xy[b] - xy[a], axis=1))
        yaw = odometry.dead_reckon(time_s)[:, 2]
        _check_turn(drive.name, "wheel odometry", lambda at: np.interp(at, time_s, yaw), time_s, xy, a, b)
    if imu is not None:
        inside = (time_s[start] >= imu.time_s[0]) & (time_s[end] <= imu.time_s[-1])
        rate = imu.gyro_radps[:, 2]
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(imu.time_s))])
        a, b = start[inside], end[inside]
        _check_turn(drive.name, "imu", lambda at: np.interp(at, imu.time_s, angle), time_s, xy, a, b)


def _check_size(name: str, what: str, rate_radps: np.ndarray, speed_mps: np.ndarray | None) -> None:
    fast = float(np.percentile(np.abs(rate_radps), 99.0)) if len(rate_radps) else 0.0
    side = 0.0 if speed_mps is None else float(np.percentile(np.abs(rate_radps * speed_mps), 95.0))
    if fast > _FASTEST_TURN_RADPS or side > _LARGEST_SIDE_MPS2:
        raise SemlocError(
            f"drive {name}: the yaw rate of the {what} reaches {fast:.3g} rad/s; expected that of a vehicle; is it in "
            "deg/s?"
        )


def _path(drive: Drive) -> tuple[np.ndarray, np.ndarray] | None:
    """Times and positions in the plane that do not come from the sensors to be checked."""
    if drive.gnss is not None and len(drive.gnss.time_s) > _MIN_WINDOWS:
        return drive.gnss.time_s, drive.gnss.p_enu[:, :2]
    if drive.truth is not None and len(drive.truth) > _MIN_WINDOWS:
        return drive.truth.time_s, drive.truth.T_map_base[:, :2, 3]
    return None


def _windows(time_s: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last position of each stretch of the path on which the vehicle moved on by 15 m."""
    starts, ends, first = [], [], 0
    for index in range(1, len(time_s)):
        if time_s[index] - time_s[first] > _LONGEST_WINDOW_S:
            first = index
        elif np.hypot(*(xy[index] - xy[first])) >= _WINDOW_M:
            starts.append(first)
            ends.append(index)
            first = index
    return np.array(starts, dtype=int), np.array(ends, dtype=int)


def _check_speed(name: str, driven_m: np.ndarray, moved_m: np.ndarray) -> None:
    if len(driven_m) < _MIN_WINDOWS:
        return
    ratio = float(np.median(driven_m / moved_m))
    if not _SPEED_RATIO[0] <= ratio <= _SPEED_RATIO[1]:
        unit = _SPEED_UNITS[min(_SPEED_UNITS, key=lambda factor: abs(np.log(max(ratio, 1e-9) / factor)))]
        raise SemlocError(
            f"drive {name}: the wheel odometry is {ratio:.3g} times as fast as the positions move; expected m/s; is it "
            f"in {unit}?"
        )


def _check_turn(
    name: str,
    what: str,
    turned: Callable[[np.ndarray], np.ndarray],
    time_s: np.ndarray,
    xy: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
) -> None:
    """Compare turns of the course from one stretch of the path to the next with what the sensor says."""
    follows = start[1:] == end[:-1]
    if follows.sum() < _MIN_WINDOWS:
        return
    step = xy[end] - xy[start]
    course = np.arctan2(step[:, 1], step[:, 0])
    middle = 0.5 * (time_s[start] + time_s[end])
    turn = np.angle(np.exp(1j * np.diff(course)))[follows]
    said = np.diff(turned(middle))[follows]
    # Fixes that jitter or a vehicle that backs up turn the course by half a circle: no sensor is judged by that.
    calm = np.abs(turn) < np.pi / 2
    turn, said = turn[calm], said[calm]
    often, often_said = float(np.median(np.abs(turn))), float(np.median(np.abs(said)))
    if len(turn) >= _MIN_WINDOWS and often_said > max(_MIN_TURN_RAD, _TURN_RATIO[1] * often):
        raise SemlocError(
            f"drive {name}: the {what} turns by {often_said:.3g} rad from one {_WINDOW_M:.0f} m to the next, "
            f"the path by {often:.2g} rad; expected a yaw rate in rad/s; is it in deg/s?"
        )
    size, size_said = np.linalg.norm(turn), np.linalg.norm(said)
    if size < _MIN_TURN_RAD or size_said == 0.0:
        return
    correlation = float(turn @ said / (size * size_said))
    ratio = float(turn @ said / size**2)
    if abs(correlation) >= _MIN_CORRELATION and not _TURN_RATIO[0] <= ratio <= _TURN_RATIO[1]:
        asked = "is left positive, about an axis that points up?" if ratio < 0 else "is it in deg/s?"
        raise SemlocError(
            f"drive {name}: the yaw rate of the {what} is {ratio:.3g} times that of the path; expected rad/s; {asked}"
        )
