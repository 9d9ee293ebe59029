"""How far the clock of the motion sensors is off that of the cameras, found while driving (room: fusion; host).

In: a MotionLog, how measured poses differ from predicted ones. Out: ClockOffset, the log as the cameras' clock sees it.
A late clock shows where speed or yaw rate change: the motion between two frames is then that of another stretch of
time. What it does to satellite fixes is the same as their slow error, and is left there.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.fusion.inertial_motion import Moving
from semloc_jax.fusion.prediction import Calibration, MotionIncrement, MotionLog
from semloc_jax.geometry import rigid

_HALF_S = 0.05
"""Speed and yaw rate are means over this long before and after: single samples are noisy; ours."""


@dataclass(frozen=True)
class ClockConfig:
    """Prior values of the clocks. All values are our choice."""

    sigma_s: float = 0.02
    """Standard deviation of the offset before anything is known: half an exposure interval and a driver's queue."""
    walk_s: float = 0.0005
    """How fast it changes [s per root of s]."""
    max_offset_s: float = 0.2
    gate: float = 25.0
    """A difference beyond this squared normalised length is an outlier."""


BELIEFS = ClockConfig()
"""The default values; no drive needed others."""


class ClockOffset(NamedTuple):
    """Time of the motion sensors less that of the cameras [s], and its variance [s^2]."""

    offset_s: Float[np.ndarray, ""]
    variance_s2: Float[np.ndarray, ""]


def unknown_offset(config: ClockConfig) -> ClockOffset:
    """What is known before driving."""
    return ClockOffset(np.float64(0.0), np.float64(config.sigma_s**2))


class CameraTimeLog:
    """A motion log asked in the time of the cameras."""

    def __init__(self, log: MotionLog, clock: ClockOffset) -> None:
        """Take a log and what its clock is off by."""
        self.log, self.clock = log, clock

    def increment(
        self, from_s: float, to_s: float, calibration: Calibration | None = None, moving: Moving | None = None
    ) -> MotionIncrement:
        """The motion between two times of the cameras; what the clock may be off by is in its covariance.

        `moving`: see `MotionLog.increment`.
        """
        found = self._plain(from_s, to_s, calibration, moving)
        slope = self._slope(found, calibration, moving)
        return found._replace(covariance=found.covariance + float(self.clock.variance_s2) * np.outer(slope, slope))

    def way_m(self, from_s: float, to_s: float) -> float:
        """About how far the vehicle drove between two times of the cameras [m]."""
        return self.log.way_m(from_s + float(self.clock.offset_s), to_s + float(self.clock.offset_s))

    def slope(
        self, from_s: float, to_s: float, calibration: Calibration | None = None, moving: Moving | None = None
    ) -> Float[np.ndarray, "6"]:
        """Derivative of the motion between two times by the offset of the clock: right tangent [m/s, rad/s].

        Zero where the vehicle moves evenly.
        """
        return self._slope(self._plain(from_s, to_s, calibration, moving), calibration, moving)

    def _slope(
        self, found: MotionIncrement, calibration: Calibration | None, moving: Moving | None
    ) -> Float[np.ndarray, "6"]:
        times_s = np.array([found.from_s, found.to_s]) + float(self.clock.offset_s)
        begin, end = (self.log.twist(float(t), _HALF_S, calibration) for t in times_s)
        if found.inertial is not None:
            _, after = found.inertial.after(moving)
            begin[:3] = moving.R_map_base.T @ moving.velocity_map
            end[:3] = (moving.R_map_base @ found.T_from_to[:3, :3]).T @ after
        return end - rigid.adjoint(rigid.inverse(found.T_from_to)) @ begin

    def _plain(
        self, from_s: float, to_s: float, calibration: Calibration | None, moving: Moving | None
    ) -> MotionIncrement:
        offset_s = float(self.clock.offset_s)
        found = self.log.increment(from_s + offset_s, to_s + offset_s, calibration, moving)
        return found._replace(from_s=from_s, to_s=to_s)


def learned(
    clock: ClockOffset,
    slope: Float[np.ndarray, "6"],
    difference: Float[np.ndarray, "6"],
    covariance: Float[np.ndarray, "6 6"],
    passed_s: float,
    config: ClockConfig,
) -> ClockOffset:
    """The offset after one more frame.

    Args:
        clock: Before.
        slope: Of the predicted motion by the offset.
        difference: Measured pose as seen from the predicted one (right tangent).
        covariance: Of the difference, what the clock may be off by included.
        passed_s: Time since the frame before [s].
        config: Beliefs.
    """
    variance = float(clock.variance_s2) + config.walk_s**2 * abs(passed_s)
    weighted = np.linalg.solve(covariance, np.column_stack([slope, difference]))
    if difference @ weighted[:, 1] > config.gate:
        return clock._replace(variance_s2=np.float64(variance))
    # The covariance holds slope variance slope^T: the gain is that of a Kalman filter with one unknown.
    gain = variance * weighted[:, 0]
    offset = np.clip(float(clock.offset_s) + gain @ difference, -config.max_offset_s, config.max_offset_s)
    left = variance * max(1.0 - float(gain @ slope), 0.01)
    return ClockOffset(np.float64(offset), np.float64(left))
