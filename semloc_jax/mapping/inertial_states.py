"""What wheels and inertial sensor say of themselves over a drive (room: mapping; host).

In: a Drive with inertial data, increasing times. Out: InertialStates: gravity, gyro and accelerometer bias, scales.
A Kalman smoother over the intervals between the times: rates turn the direction of gravity, the accelerometer shows it
beside the acceleration of the wheels, which gives the odometer scale; wheels that stand or turn give the gyro bias.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from semloc_jax.datasets import Drive
from semloc_jax.geometry import rigid
from semloc_jax.structs import InertialNoise

_Measurement = tuple[np.ndarray, np.ndarray, np.ndarray]
_UP, _GYRO, _ACCEL, _SCALE, _TURN = slice(0, 3), slice(3, 6), slice(6, 9), 9, 10
_NUM = 11


@dataclass(frozen=True)
class InertialConfig:
    """Beliefs about the sensors beside the white noise of the gyroscope. All values are ours, of a production car."""

    gravity_mps2: float = 9.81
    gyro_walk_degps: float = 0.01
    """Change of a gyro bias [deg/s per root of s], over a whole drive; ours."""
    gyro_bias_degps: float = 0.5
    accel_density_mps2: tuple[float, float, float] = (0.1, 0.04, 0.1)
    """Error of the acceleration along base x, y, z [m/s^2 per root of the rate in Hz]: road, suspension, and along x
    the difference of wheel speeds."""
    accel_bias_mps2: float = 0.05
    odometer_sigma: float = 0.02
    wheel_turn_sigma: float = 0.05
    wheel_yaw_density_degps: float = 0.1
    road_slope_deg: float = 3.0
    road_slope_s: float = 10.0
    """Without an accelerometer: how steep roads are, and for how long they stay so."""
    standing_mps: float = 0.02
    """A speed below this, all through an interval, is that of a vehicle that stands."""
    max_gap_s: float = 0.15
    """An interval with a longer gap of a sensor is not a measurement of it."""
    outlier: float = 1e-3
    """Measurements that are less likely than this count as much less as they are farther off."""
    longest_s: float = 0.25
    """Motion is taken as even within intervals no longer than this."""

    @property
    def bias_memory_s(self) -> float:
        """For how long what a smoother leaves of a bias stays the same: a walk that the turn of the wheels shows."""
        return self.wheel_yaw_density_degps / self.gyro_walk_degps


_Beliefs = tuple[InertialConfig, InertialNoise]


class InertialStates(NamedTuple):
    """States at the given times, from all that the drive says before and after."""

    time_s: Float[np.ndarray, " n"]
    up_base: Float[np.ndarray, "n 3"]
    """Unit direction against gravity."""
    gyro_bias_radps: Float[np.ndarray, "n 3"]
    gyro_bias_sigma_radps: Float[np.ndarray, "n 3"]
    odometer_scale: float
    """True speed over wheel speed."""
    odometer_scale_sigma: float
    tilt_sigma_rad: Float[np.ndarray, " n"]
    """Of roll and pitch."""


class _Intervals(NamedTuple):
    """Means over the intervals between the times."""

    step_s: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    wheel_rate: np.ndarray
    has_accelerometer: bool
    has_imu: np.ndarray
    has_wheels: np.ndarray
    is_standing: np.ndarray


def inertial_states(drive: Drive, time_s: Float[np.ndarray, " n"], config: InertialConfig) -> InertialStates:
    """The states at increasing times of a drive that has inertial data and wheel odometry.

    Args:
        drive: With `imu` and `odometry`.
        time_s: At least two times.
        config: Beliefs.
    """
    knots_s, of_time = _knots(time_s, config.longest_s)
    means = _intervals(drive, knots_s, config)
    x, P = (states[of_time] for states in _filtered(means, (config, drive.imu.noise)))
    variance = np.diagonal(P, axis1=1, axis2=2)
    up = x[:, _UP] / np.linalg.norm(x[:, _UP], axis=1, keepdims=True)
    return InertialStates(
        time_s,
        up,
        x[:, _GYRO],
        np.sqrt(variance[:, _GYRO]),
        float(x[-1, _SCALE]),
        float(np.sqrt(variance[-1, _SCALE])),
        np.sqrt(0.5 * np.sum(variance[:, :2], axis=1)),
    )


def _knots(time_s: np.ndarray, longest_s: float) -> tuple[np.ndarray, np.ndarray]:
    """The times and as many between them that no interval is long; where the times stand among them."""
    pieces = np.ceil(np.diff(time_s) / longest_s).astype(int)
    of_time = np.concatenate([[0], np.cumsum(pieces)])
    return np.interp(np.arange(of_time[-1] + 1), of_time, time_s), of_time


def _intervals(drive: Drive, time_s: np.ndarray, config: InertialConfig) -> _Intervals:
    imu, wheels, step_s = drive.imu, drive.odometry, np.diff(time_s)
    inertial = np.column_stack([imu.gyro_radps, imu.accel_mps2])
    mean = _mean(imu.time_s, inertial, time_s)
    turned = _mean(wheels.time_s, np.column_stack([wheels.speed_mps, wheels.yaw_rate_radps]), time_s)
    speed = np.interp(time_s, wheels.time_s, wheels.speed_mps)
    has_imu = _is_covered(imu.time_s, time_s, config.max_gap_s)
    has_wheels = _is_covered(wheels.time_s, time_s, config.max_gap_s)
    top = _mean(wheels.time_s, np.abs(wheels.speed_mps)[:, None], time_s)[:, 0]
    standing = has_wheels & (np.maximum(top, np.maximum(np.abs(speed[1:]), np.abs(speed[:-1]))) < config.standing_mps)
    return _Intervals(
        step_s=step_s,
        rate=mean[:, :3],
        force=mean[:, 3:],
        speed=turned[:, 0],
        acceleration=np.diff(speed) / step_s,
        wheel_rate=turned[:, 1],
        has_accelerometer=bool(imu.accel_mps2.any()),
        has_imu=has_imu,
        has_wheels=has_wheels,
        is_standing=standing,
    )


def _mean(at_s: np.ndarray, rows: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Means of samples, joined by straight lines, between neighbouring times."""
    steps = 0.5 * (rows[1:] + rows[:-1]) * np.diff(at_s)[:, None]
    total = np.concatenate([np.zeros((1, rows.shape[1])), np.cumsum(steps, axis=0)])
    at = np.column_stack([np.interp(time_s, at_s, column) for column in total.T])
    # Beyond the log the last value continues.
    beyond_s = time_s - np.clip(time_s, at_s[0], at_s[-1])
    nearest = np.column_stack([np.interp(time_s, at_s, column) for column in rows.T])
    return np.diff(at + beyond_s[:, None] * nearest, axis=0) / np.diff(time_s)[:, None]


def _is_covered(at_s: np.ndarray, time_s: np.ndarray, max_gap_s: float) -> np.ndarray:
    """Whether the samples leave no long gap in each interval."""
    gaps = np.flatnonzero(np.diff(at_s) > max_gap_s)
    begin, end = np.append(at_s[gaps], [-np.inf, at_s[-1]]), np.append(at_s[gaps + 1], [at_s[0], np.inf])
    begin[-1] += max_gap_s
    end[-2] -= max_gap_s
    overlap = (time_s[:-1, None] < end) & (time_s[1:, None] > begin)
    return ~overlap.any(axis=1)


def _filtered(means: _Intervals, beliefs: _Beliefs) -> tuple[np.ndarray, np.ndarray]:
    """States and covariances at every time, smoothed (Rauch, Tung, Striebel)."""
    num = len(means.step_s) + 1
    x, P = np.zeros((num, _NUM)), np.zeros((num, _NUM, _NUM))
    ahead, spread, moved = x.copy(), P.copy(), P.copy()
    x[0], P[0] = _first(beliefs[0])
    for k in range(num - 1):
        ahead[k + 1], moved[k + 1] = _predicted(x[k], means, k)
        spread[k + 1] = moved[k + 1] @ P[k] @ moved[k + 1].T + _process(means.step_s[k], means.has_imu[k], beliefs)
        x[k + 1], P[k + 1] = _corrected(ahead[k + 1], spread[k + 1], means, k, beliefs)
    for k in range(num - 2, -1, -1):
        gain = np.linalg.solve(spread[k + 1], moved[k + 1] @ P[k]).T
        x[k] += gain @ (x[k + 1] - ahead[k + 1])
        P[k] += gain @ (P[k + 1] - spread[k + 1]) @ gain.T
    return x, P


def _first(config: InertialConfig) -> tuple[np.ndarray, np.ndarray]:
    x = np.zeros(_NUM)
    x[2] = x[_SCALE] = x[_TURN] = 1.0
    sigma = np.zeros(_NUM)
    sigma[_UP], sigma[_GYRO], sigma[_ACCEL] = 0.15, np.deg2rad(config.gyro_bias_degps), config.accel_bias_mps2
    sigma[_SCALE], sigma[_TURN] = config.odometer_sigma, config.wheel_turn_sigma
    return x, np.diag(sigma**2)


def _predicted(x: np.ndarray, means: _Intervals, k: int) -> tuple[np.ndarray, np.ndarray]:
    """State after an interval, and its derivative."""
    turn = (means.rate[k] - x[_GYRO]) * means.step_s[k]
    back = _rotation(-turn)
    after, F = x.copy(), np.eye(_NUM)
    after[_UP] = back @ x[_UP]
    F[_UP, _UP] = back
    F[_UP, _GYRO] = -rigid.skew(after[_UP]) * means.step_s[k]
    return after, F


def _process(step_s: float, has_imu: np.bool_, beliefs: _Beliefs) -> np.ndarray:
    sigma, (config, noise) = np.zeros(_NUM), beliefs
    sigma[_UP] = noise.gyro_density if has_imu else 10.0 * noise.gyro_density
    sigma[_GYRO] = np.deg2rad(config.gyro_walk_degps)
    return np.diag(sigma**2 * step_s)


def _corrected(
    x: np.ndarray, P: np.ndarray, means: _Intervals, k: int, beliefs: _Beliefs
) -> tuple[np.ndarray, np.ndarray]:
    """State after what the sensors say of one interval."""
    for H, measured, sigma in _measurements(x, means, k, beliefs):
        noise, off = np.diag(sigma**2 / means.step_s[k]), measured - H @ x
        S = H @ P @ H.T + noise
        # A wheel in a pothole, or a turn that its interval does not resolve, would outweigh a drive.
        S += max(float(off @ np.linalg.solve(S, off)) / chdtri(len(off), beliefs[0].outlier) - 1.0, 0.0) * noise
        gain = np.linalg.solve(S, H @ P).T
        x = x + gain @ off
        P = P - gain @ H @ P
        P = 0.5 * (P + P.T)
    return x, P


def _measurements(x: np.ndarray, means: _Intervals, k: int, beliefs: _Beliefs) -> Iterator[_Measurement]:
    """Derivative by the state, value and noise density of what was measured in an interval."""
    H, (config, noise) = np.zeros((3, _NUM)), beliefs
    if not means.has_accelerometer:
        slope = np.deg2rad(config.road_slope_deg) * np.sqrt(config.road_slope_s)
        H[:, _UP] = np.eye(3)
        yield H[:2], np.zeros(2), np.full(2, slope)
    elif means.has_imu[k] and means.has_wheels[k]:
        rate, speed = means.rate[k] - x[_GYRO], means.speed[k]
        H[:, _UP] = config.gravity_mps2 * _rotation(0.5 * rate * means.step_s[k])
        H[:, _ACCEL] = np.eye(3)
        # Only to the side does the scale count: elsewhere noise of the other factor would pull it towards zero.
        H[1, _SCALE] = speed * rate[2]
        other = x[_SCALE] * np.array([means.acceleration[k], 0.0, -speed * rate[1]])
        yield H, means.force[k] - other, np.array(config.accel_density_mps2)
    if not means.has_imu[k]:
        return
    H = np.zeros((3, _NUM))
    H[:, _GYRO] = np.eye(3)
    if means.is_standing[k]:
        yield H, means.rate[k], np.full(3, noise.gyro_density)
    elif means.has_wheels[k]:
        H[2, _TURN] = means.wheel_rate[k]
        yield H[2:], means.rate[k, 2:], np.full(1, np.deg2rad(config.wheel_yaw_density_degps))


def _rotation(omega: np.ndarray) -> np.ndarray:
    return rigid.exp(np.concatenate([np.zeros(3), omega]))[:3, :3]
