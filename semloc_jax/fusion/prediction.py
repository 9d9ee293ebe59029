"""How the vehicle moved between two times, from wheels and inertial sensor (room: fusion; host).

In: time-stamped samples in any order, with gaps. Out: MotionIncrement: motion, covariance, derivative by calibration.
"""

import enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.inertial_motion import InertialMotion, Moving, inertial_motion
from semloc_jax.fusion.inertial_samples import steps_of
from semloc_jax.fusion.motion_noise import MotionNoise
from semloc_jax.fusion.sample_stream import SampleStream
from semloc_jax.fusion.velocity_sample import VelocitySample
from semloc_jax.geometry import rigid
from semloc_jax.structs import InertialNoise


class MotionQuality(enum.StrEnum):
    """Where the motion of an increment comes from."""

    OK = "ok"
    """Speed and yaw rate were measured all the way."""
    EXTRAPOLATED = "extrapolated"
    """Speed or yaw rate is the last measured one for a part of the way."""
    MISSING = "missing"
    """Nothing was measured for long: no motion is given, the covariance is that of a vehicle that may drive."""


class Calibration(NamedTuple):
    """What the sensors are off by: true speed = odometer_scale x speed, true yaw rate = yaw rate - gyro_bias_radps."""

    odometer_scale: float = 1.0
    gyro_bias_radps: float = 0.0
    travel_rad: float = 0.0
    """Direction of travel against base x, positive to the left: what defines the base frame (cameras, an inertial unit)
    is never mounted exactly along the way the rear axle rolls."""


class MotionIncrement(NamedTuple):
    """Motion of the vehicle between two times: T_map_base(to) = T_map_base(from) T_from_to exp(jacobian d + noise)."""

    T_from_to: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    """Of the right tangent [m, rad]; the errors of the calibration are not in it but in `jacobian`."""
    from_s: float
    to_s: float
    jacobian: Float[np.ndarray, "6 3"]
    """Derivative of the right tangent by d = (odometer scale, gyro bias [rad/s], direction of travel [rad])."""
    quality: MotionQuality
    calibration: Calibration = Calibration()
    """What was taken for it: where `jacobian` holds."""
    inertial: InertialMotion | None = None
    """What the inertial sensor says, where the motion was asked for with what it begins with."""
    velocity: VelocitySample | None = None
    """At the end, where wheels or cameras measured it."""

    def corrected(self, calibration: Calibration) -> Float[np.ndarray, "4 4"]:
        """T_from_to for another calibration, to first order."""
        change = np.subtract(calibration, self.calibration)
        return self.T_from_to @ rigid.exp(self.jacobian @ change)


def coasted(
    increment: MotionIncrement, twist: Float[np.ndarray, "6"], age_s: float, memory_s: float, noise: MotionNoise
) -> MotionIncrement:
    """The increment of constant motion, for times when no sensor measures the motion.

    Args:
        increment: One of quality MISSING; its times are kept.
        twist: Mean motion so far [m/s, rad/s].
        age_s: Time since the pose was last measured, at the start of the increment [s].
        memory_s: Time by which the mean lags behind [s].
        noise: What a vehicle may do meanwhile. All increments since the last measured pose add up to what a constant
            unknown acceleration does.
    """
    step_s, age_s = abs(increment.to_s - increment.from_s), max(age_s, 0.0)
    grown = 0.25 * ((age_s + step_s) ** 4 - age_s**4) + (memory_s * step_s) ** 2
    acceleration = np.array([1.0, 0.2, 0.2]) * noise.unknown_acceleration_mps2
    turn = np.deg2rad(np.array([0.2, 0.2, 1.0]) * noise.unknown_yaw_acceleration_degps2)
    covariance = np.diag(np.concatenate([acceleration, turn]) ** 2 * grown)
    T_from_to = rigid.exp(twist * (increment.to_s - increment.from_s))
    return increment._replace(T_from_to=T_from_to, covariance=covariance, jacobian=np.zeros((6, 3)))


_SAME_IMAGE_S = 0.02
"""A velocity by cameras belongs to an image time of the motion clock, which may be off by so much; our choice."""
_LEVEL_S = 2.0
"""Time before a gap of the wheels from which the level of the accelerometer is taken; ours."""


class MotionLog:
    """Buffer of wheel and inertial samples that says how the vehicle moved between any two times.

    The translation comes from the wheel speed along the direction of travel, the rotation from the gyroscope about all
    three axes, or from the wheels where there is no gyroscope. A sensor that falls silent is replaced by its last
    value, for at most `max_hold_s`, with a covariance that grows as the vehicle may accelerate. Within one increment
    the error of what is not measured is one and the same; from increment to increment it is taken for new, as the poses
    of a filter in between take most of it out: without any, three sigmas still hold the worst of 2 s.
    """

    def __init__(self, noise: MotionNoise | None = None, max_gap_s: float = 0.15, max_hold_s: float = 5.0) -> None:
        """An empty log; samples closer than `max_gap_s` [s] are joined by straight lines."""
        self.noise, self.max_gap_s, self.max_hold_s = noise or MotionNoise(), max_gap_s, max_hold_s
        self.inertial_noise = InertialNoise()
        """White noise of its rates; where biases and velocity are estimated too, all of it."""
        self._wheels, self._imu, self._velocity = SampleStream(2), SampleStream(6), SampleStream(12)

    @classmethod
    def of_drive(cls, drive: Drive, noise: MotionNoise | None = None) -> "MotionLog":
        """The log of a whole drive; empty where the drive has neither odometry nor inertial data."""
        log = cls(noise)
        if drive.odometry is not None:
            odometry = drive.odometry
            log._wheels.times = [float(t) for t in odometry.time_s]
            log._wheels.rows = list(np.column_stack([odometry.speed_mps, odometry.yaw_rate_radps]))
        if drive.imu is not None:
            order = np.argsort(drive.imu.time_s, kind="stable")
            log._imu.times = [float(t) for t in drive.imu.time_s[order]]
            log.inertial_noise = drive.imu.noise
            log._imu.rows = list(np.column_stack([drive.imu.gyro_radps, drive.imu.accel_mps2])[order])
        return log

    def add_wheels(self, time_s: float, speed_mps: float, yaw_rate_radps: float) -> None:
        """Take one sample of speed and yaw rate of the rear axle, in any order.

        Raises:
            SemlocError: the sample is not finite.
        """
        self._wheels.add(time_s, np.array([speed_mps, yaw_rate_radps], np.float64), "wheel odometry")

    def add_wheel_pair(self, time_s: float, left_mps: float, right_mps: float, track_m: float) -> None:
        """Take one sample of the speeds of the left and right rear wheel, `track_m` apart.

        Raises:
            SemlocError: the sample is not finite or the track is not positive.
        """
        if not track_m > 0.0:
            raise SemlocError(f"wheel speeds: track {track_m} m; expected the distance of the wheels, e.g. 1.6 m")
        self.add_wheels(time_s, 0.5 * (left_mps + right_mps), (right_mps - left_mps) / track_m)

    def add_velocity(self, time_s: float, sample: VelocitySample) -> None:
        """Take the velocity that cameras measured, in any order; such samples are used in place of wheels.

        Raises:
            SemlocError: the sample is not finite.
        """
        self._velocity.add(time_s, np.concatenate(sample).astype(np.float64), "velocity")

    def add_imu(self, time_s: float, gyro_radps: Float[np.ndarray, "3"], accel_mps2: Float[np.ndarray, "3"]) -> None:
        """Take one inertial sample in the base frame, in any order.

        Raises:
            SemlocError: the sample is not finite.
        """
        self._imu.add(time_s, np.concatenate([gyro_radps, accel_mps2]).astype(np.float64), "inertial sample")

    def forget(self, before_s: float) -> None:
        """Drop samples older than `before_s` [s], but for the last one before it: a log that runs for hours stays
        small."""
        for stream in (self._wheels, self._imu, self._velocity):
            stream.forget(before_s)

    def _inertial_speed(self, time_s: np.ndarray, gap_s: float) -> np.ndarray | None:
        """Change of speed since the last wheel sample, from the accelerometer [m/s]; None without one.

        What the accelerometer shows beside the change of the wheel speed over the last `_LEVEL_S` before that is slope,
        pitch and bias; it is taken off.

        Args:
            time_s: Increasing times.
            gap_s: When the wheels fell silent.
        """
        before_s = np.array([gap_s - _LEVEL_S, gap_s])
        wheels, age_s = self._wheels.at(before_s, self.max_gap_s)
        knots_s = np.array([*before_s[:1], *self._imu.between(before_s[0], time_s[-1]), time_s[-1]])
        knots_s = np.unique(np.concatenate([knots_s, [gap_s], time_s]))
        middle_s = 0.5 * (knots_s[1:] + knots_s[:-1])
        imu, imu_age = self._imu.at(middle_s, self.max_gap_s)
        if age_s.any() or imu_age.any() or not imu[:, 3:].any():
            return None
        gained = np.concatenate([[0.0], np.cumsum(imu[:, 3] * np.diff(knots_s))])
        at_gap = np.interp(gap_s, knots_s, gained)
        level = (at_gap - (wheels[1, 0] - wheels[0, 0])) / _LEVEL_S
        return np.interp(time_s, knots_s, gained) - at_gap - level * (time_s - gap_s)

    def is_silent(self, from_s: float, to_s: float) -> bool:
        """Whether no wheel speed was measured between two times: nothing says how far the vehicle drove."""
        _, age_s = self._wheels.at(np.linspace(from_s, to_s, 9), self.max_gap_s)
        return bool((age_s > 0.0).all())

    def way_m(self, from_s: float, to_s: float) -> float:
        """About how far the vehicle drove between two times, forth and back added [m]; 0 where no wheel says so."""
        knots_s = np.array([from_s, *self._wheels.between(from_s, to_s), to_s])
        wheels, _ = self._wheels.at(0.5 * (knots_s[1:] + knots_s[:-1]), self.max_gap_s)
        return float(np.abs(wheels[:, 0]) @ np.diff(knots_s)) if to_s > from_s else 0.0

    def twist(self, time_s: float, half_s: float, calibration: Calibration | None = None) -> Float[np.ndarray, "6"]:
        """Mean motion around a time [m/s, rad/s].

        Args:
            time_s: Middle [s].
            half_s: The mean is taken over this long before and after [s].
            calibration: What to take off; None for nothing.
        """
        calibration = calibration or Calibration()
        times = time_s + half_s * np.linspace(-1.0, 1.0, 5)
        wheels, speed_age = self._wheels.at(times, self.max_gap_s)
        imu, imu_age = self._imu.at(times, self.max_gap_s)
        has_gyro = (imu_age == 0.0) | (imu_age < speed_age)
        turn = np.where(has_gyro[:, None], imu[:, :3], wheels[:, 1:] * [0.0, 0.0, 1.0]).mean(axis=0)
        speed = calibration.odometer_scale * wheels[:, 0].mean()
        ahead, left = np.cos(calibration.travel_rad), np.sin(calibration.travel_rad)
        return np.array([speed * ahead, speed * left, 0.0, turn[0], turn[1], turn[2] - calibration.gyro_bias_radps])

    def increment(
        self, from_s: float, to_s: float, calibration: Calibration | None = None, moving: Moving | None = None
    ) -> MotionIncrement:
        """The motion between two times; `to_s` may lie before `from_s`.

        Args:
            from_s: Start [s].
            to_s: End [s].
            calibration: What to take off; None for nothing.
            moving: How the vehicle moves at `from_s`: the motion is then that of the inertial sensor, where it measured
                all the way, and wheels or cameras give a velocity at the end.
        """
        calibration = calibration or Calibration()
        if moving is not None and to_s > from_s:
            inertial = self._inertial(from_s, to_s, moving)
            if inertial is not None:
                T, _ = inertial.after(moving)
                covariance, none = inertial.covariance_after(moving), np.zeros((6, 3))
                ok, velocity = MotionQuality.OK, self._velocity_at(from_s, to_s, calibration)
                return MotionIncrement(T, covariance, from_s, to_s, none, ok, calibration, inertial, velocity)
        if to_s == from_s:
            quality = MotionQuality.OK
            return MotionIncrement(np.eye(4), np.zeros((6, 6)), from_s, to_s, np.zeros((6, 3)), quality, calibration)
        if to_s < from_s:
            return _reversed(self.increment(to_s, from_s, calibration))
        inside = {*self._wheels.between(from_s, to_s), *self._imu.between(from_s, to_s)}
        steps = self._steps(np.array([from_s, *sorted(inside), to_s]), calibration)
        if steps.unmeasured_s > self.max_hold_s:
            return self._unknown(from_s, to_s, calibration)
        T, covariance, jacobian = np.eye(4), np.zeros((6, 6)), np.zeros((6, 5))
        motions = rigid.exp(steps.xi)
        back = rigid.adjoint(rigid.inverse(motions))
        for k, motion in enumerate(motions):
            T = T @ motion
            covariance = back[k] @ covariance @ back[k].T + np.diag(steps.variance[k])
            jacobian = back[k] @ jacobian + steps.jacobian[k]
        # What is not measured is off by one and the same error all the way.
        covariance += jacobian[:, 3:] @ jacobian[:, 3:].T
        quality = MotionQuality.EXTRAPOLATED if steps.unmeasured_s > 0.0 else MotionQuality.OK
        return MotionIncrement(T, covariance, from_s, to_s, jacobian[:, :3], quality, calibration)

    def _inertial(self, from_s: float, to_s: float, moving: Moving) -> InertialMotion | None:
        """What the inertial sensor says of a stretch of time; None where it did not measure all the way."""
        knots_s = np.array([from_s, *self._imu.between(from_s, to_s), to_s])
        rows, age_s = self._imu.at(knots_s, self.max_gap_s)
        if age_s.any() or not rows[:, 3:].any():
            return None
        steps = steps_of(knots_s, rows[:, :3], rows[:, 3:])
        return inertial_motion(steps, moving.bias, self.inertial_noise).turned(moving.R_base_imu)

    def _velocity_at(self, from_s: float, to_s: float, calibration: Calibration) -> VelocitySample | None:
        """The velocity that was measured at the end of a stretch of time, each one for one stretch only."""
        if self._velocity.times:
            inside = self._velocity.between(from_s + _SAME_IMAGE_S, to_s + _SAME_IMAGE_S)
            if not inside:
                return None
            row = self._velocity.at(np.array(inside[-1:]), self.max_gap_s)[0][0]
            return VelocitySample(*np.split(row, 4))
        wheels, age_s = self._wheels.at(np.array([to_s]), self.max_gap_s)
        if age_s[0] > 0.0:
            return None
        ahead, left = np.cos(calibration.travel_rad), np.sin(calibration.travel_rad)
        return VelocitySample(wheels[0, 0] * np.array([ahead, left, 0.0]), np.array(self.noise.wheel_velocity_mps))

    def _steps(self, knots_s: np.ndarray, calibration: Calibration) -> "_Steps":
        """Motions of constant speed and rate between neighbouring samples."""
        noise, step_s, middle_s = self.noise, np.diff(knots_s), 0.5 * (knots_s[1:] + knots_s[:-1])
        wheels, speed_age = self._wheels.at(middle_s, self.max_gap_s)
        imu, imu_age = self._imu.at(middle_s, self.max_gap_s)
        has_gyro = (imu_age == 0.0) | (imu_age < speed_age)
        yaw_age = np.where(has_gyro, imu_age, speed_age)
        turn = np.where(has_gyro[:, None], imu[:, :3], wheels[:, 1:] * [0.0, 0.0, 1.0]) * step_s[:, None]
        turn[:, 2] -= calibration.gyro_bias_radps * step_s
        # A car rolls and pitches about the road: the last roll or pitch rate must not be extrapolated.
        turn[imu_age > 0.0, :2] = 0.0
        acceleration = np.full(len(step_s), noise.unknown_acceleration_mps2)
        is_silent = (speed_age > 0.0) & np.isfinite(speed_age) & (imu_age == 0.0)
        begin_s = np.round(middle_s - speed_age, 6)
        for gap_s in np.unique(begin_s[is_silent]):
            rows = is_silent & (begin_s == gap_s)
            gained = self._inertial_speed(middle_s[rows], float(gap_s))
            if gained is not None:
                wheels[rows, 0] += gained
                acceleration[rows] = noise.inertial_acceleration_mps2
        driven = wheels[:, 0] * step_s
        distance = calibration.odometer_scale * driven

        wheel_density = np.deg2rad(noise.wheel_yaw_density_degps)
        yaw_density = np.where(has_gyro, self.inertial_noise.gyro_density, wheel_density)
        tilt_density = np.deg2rad(np.where(imu_age == 0.0, noise.tilt_density_degps, noise.tilt_without_gyro_degps))
        turn_share = np.where(has_gyro, noise.gyro_turn_share, noise.wheel_turn_share)
        variance = np.zeros((len(step_s), 6))
        side_slip = noise.side_slip_share + noise.side_slip_per_mps2 * np.abs(wheels[:, 0] * turn[:, 2] / step_s)
        for axis, share in enumerate((noise.slip_share, side_slip, noise.heave_share)):
            variance[:, axis] = share**2 * np.abs(distance) * noise.slip_length_m
        variance[:, 0] += noise.speed_density_mps**2 * step_s
        variance[:, 3:5] = (tilt_density**2 * step_s)[:, None]
        variance[:, 5] = yaw_density**2 * step_s + turn_share**2 * np.abs(turn[:, 2])

        speed_error = acceleration * np.where(np.isfinite(speed_age), speed_age, 0.0)
        yaw_error = np.deg2rad(noise.unknown_yaw_acceleration_degps2) * np.where(np.isfinite(yaw_age), yaw_age, 0.0)
        ahead, left = np.cos(calibration.travel_rad), np.sin(calibration.travel_rad)
        xi = np.column_stack([distance * ahead, distance * left, np.zeros(len(step_s)), turn])
        chart = rigid.right_jacobian(xi)
        along, about = ahead * chart[:, :, 0] + left * chart[:, :, 1], chart[:, :, 5]
        across = ahead * chart[:, :, 1] - left * chart[:, :, 0]
        columns = (
            along * driven[:, None],
            -about * step_s[:, None],
            across * distance[:, None],
            along * (speed_error * step_s)[:, None],
            about * (yaw_error * step_s)[:, None],
        )
        jacobian = np.stack(columns, axis=-1)
        return _Steps(xi, variance, jacobian, float(max(speed_age.max(), yaw_age.max())))

    def _unknown(self, from_s: float, to_s: float, calibration: Calibration) -> MotionIncrement:
        """No motion, with the covariance of a vehicle that may do anything."""
        noise = self.noise
        tilt, turn = np.deg2rad(noise.tilt_without_gyro_degps), np.deg2rad(noise.unknown_yaw_rate_degps)
        along, across = noise.unknown_speed_mps, 0.1 * noise.unknown_speed_mps
        sigma = np.array([along, across, across, tilt, tilt, turn]) * (to_s - from_s)
        jacobian = np.zeros((6, 3))
        return MotionIncrement(np.eye(4), np.diag(sigma**2), from_s, to_s, jacobian, MotionQuality.MISSING, calibration)


class _Steps(NamedTuple):
    xi: np.ndarray
    variance: np.ndarray
    jacobian: np.ndarray
    """By the calibration, and by one sigma of a speed and a yaw rate that are not measured."""
    unmeasured_s: float


def _reversed(increment: MotionIncrement) -> MotionIncrement:
    Ad = rigid.adjoint(increment.T_from_to)
    return increment._replace(
        T_from_to=rigid.inverse(increment.T_from_to),
        covariance=Ad @ increment.covariance @ Ad.T,
        from_s=increment.to_s,
        to_s=increment.from_s,
        jacobian=-Ad @ increment.jacobian,
    )
