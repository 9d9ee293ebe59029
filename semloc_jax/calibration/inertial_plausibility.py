"""What looks wrong in the data of an inertial sensor: units, axes, clock, mount (room: calibration; host).

In: an inertial log, how cameras saw the vehicle turn. Out: findings as text. Limits are ours.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.calibration.turns_of_cameras import CameraTurns
from semloc_jax.cameras.plausibility import Finding
from semloc_jax.datasets import Imu
from semloc_jax.datasets.inertial import wrong_forces
from semloc_jax.structs import InertialNoise

LEAST_TURNS, _LEAST_SAMPLES = 20, 50
_LATEST_S, _STEP_S = 0.12, 0.004
_TELLING_S, _TELLING_DEG, _TELLING_SIGMAS = 0.004, 2.0, 4.0
"""Smaller differences, or such as noise explains, are not told."""
_AROUND = 3
"""Steps to each side over which the best delay is found by a parabola."""
_TAIL = 4.0
"""A turn whose square is so many times the usual one pulls half as much."""
_LEAST_CORRELATION = 0.7
_DEGREES = 57.3
_NOISE_FACTOR = 8.0
"""Stated noise is often taken two or three times too large on purpose; a wrong unit is ten times off and more."""
_AXES = "xyz"


class ClockOfTurns(NamedTuple):
    """How the turns of the inertial sensor lie against those of the cameras."""

    delay_s: float
    """Clock of the inertial sensor less that of the cameras."""
    delay_sigma_s: float
    ratio: float
    """Size of the rates over those of the cameras."""
    turn_deg: Float[np.ndarray, "3"]
    """Rotation vector that turns the axes of the sensor into those of the base."""
    turn_sigma_deg: Float[np.ndarray, "3"]
    swapped: tuple[str, ...]
    """Axes that show another axis of the vehicle, in words."""
    is_told: bool
    """Whether sensor and camera turn alike about any axis: a vehicle that stands or goes straight tells nothing."""


def implausible_inertial(imu: Imu, turns: CameraTurns | None) -> list[Finding]:
    """What looks wrong; empty for data that may be right.

    Args:
        imu: In the axes of the base, as the drive gives it.
        turns: Of a camera; None or few: only the forces are looked at.
    """
    texts = [text for text in (wrong_forces(imu),) if text]
    if turns is not None:
        inside = (turns.from_s > imu.time_s[0] + _LATEST_S) & (turns.to_s < imu.time_s[-1] - _LATEST_S)
        if inside.sum() >= LEAST_TURNS:
            texts += _turns(compared(imu, CameraTurns(*(part[inside] for part in turns))))
    return [Finding("imu", "inertial", text) for text in texts]


def implausible_noise(imu: Imu, stated: InertialNoise) -> list[Finding]:
    """What looks wrong in the stated white noise of a sensor: a density that its own log contradicts."""
    if len(imu.time_s) < _LEAST_SAMPLES:
        return []
    rate_hz = 1.0 / float(np.median(np.diff(imu.time_s)))
    texts = []
    for name, readings, density in (
        ("gyroscope", imu.gyro_radps, stated.gyro_density),
        ("accelerometer", imu.accel_mps2, stated.accel_density),
    ):
        # What changes from sample to sample is noise; second differences leave out how the vehicle moves.
        rough = readings[2:] - 2.0 * readings[1:-1] + readings[:-2]
        measured = float(np.median(1.4826 * np.median(np.abs(rough), axis=0)) / np.sqrt(6.0 * rate_hz))
        if measured > 0.0 and not 1.0 / _NOISE_FACTOR < density / measured < _NOISE_FACTOR:
            texts.append(
                f"{name}_noise_density is {density:.2g}; its samples say {measured:.2g} per root of Hz; expected "
                f"within {_NOISE_FACTOR:g} times: a standard deviation of samples is divided by the root of the rate, "
                "deg/s by 57.3"
            )
    return [Finding("imu", "inertial", text) for text in texts]


def compared(imu: Imu, turns: CameraTurns) -> ClockOfTurns:
    """Delay, size and axes of the rates of the sensor, by all turns of a drive."""
    seen = turns.rate_base_radps - np.median(turns.rate_base_radps, axis=0)
    delays = np.arange(-_LATEST_S, _LATEST_S + _STEP_S / 2, _STEP_S)
    fits = [_fit(seen, _mean_rates(imu, turns, delay)) for delay in delays]
    squares = np.stack([fit.squares for fit in fits])
    # One robust measure for all delays: what is usual at the best of them.
    usual = _TAIL * float(np.median(squares, axis=1).min()) + 1e-18
    costs = usual * np.sum(np.log1p(squares / usual), axis=1)
    best = int(np.clip(np.argmin(costs), _AROUND, len(delays) - 1 - _AROUND))
    near = slice(best - _AROUND, best + _AROUND + 1)
    bend, slope, _ = np.polyfit(delays[near] - delays[best], costs[near], 2)
    bend = max(float(bend), 1e-12)
    shift = np.clip(-0.5 * slope / bend, -_AROUND * _STEP_S, _AROUND * _STEP_S)
    noise = float(costs[best]) / (3 * len(seen))
    fit = fits[best]
    spread = np.sum(seen**2) * np.eye(3) - seen.T @ seen
    turn_sigma = np.sqrt(noise * np.diag(np.linalg.inv(spread + 1e-12 * np.eye(3))))
    return ClockOfTurns(
        float(delays[best] + shift),
        float(np.sqrt(noise / bend)),
        fit.ratio,
        np.rad2deg(fit.turn),
        np.rad2deg(turn_sigma),
        fit.swapped,
        fit.is_told,
    )


class _Fit(NamedTuple):
    squares: Float[np.ndarray, " n"]
    """Of what is left of each turn."""
    ratio: float
    turn: Float[np.ndarray, "3"]
    swapped: tuple[str, ...]
    is_told: bool


def _mean_rates(imu: Imu, turns: CameraTurns, delay_s: float) -> Float[np.ndarray, "n 3"]:
    """Of the sensor over the same times, less their median: its bias."""
    step_s = np.diff(imu.time_s)[:, None]
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * step_s * (imu.gyro_radps[1:] + imu.gyro_radps[:-1]), 0)])
    ends = [
        np.stack([np.interp(t + delay_s, imu.time_s, column) for column in angle.T], axis=1)
        for t in (turns.from_s, turns.to_s)
    ]
    rates = (ends[1] - ends[0]) / (turns.to_s - turns.from_s)[:, None]
    return rates - np.median(rates, axis=0)


def _fit(seen: Float[np.ndarray, "n 3"], rates: Float[np.ndarray, "n 3"]) -> _Fit:
    """Size, axes and a small turn that bring the rates of the sensor to those seen, and what is left."""
    correlation = _correlation(seen, rates)
    axis = np.argmax(np.abs(correlation), axis=1)
    sign = np.sign(correlation[np.arange(3), axis])
    is_told = np.abs(correlation[np.arange(3), axis]) > _LEAST_CORRELATION
    is_wrong = is_told & ((axis != np.arange(3)) | (sign < 0))
    swapped = tuple(
        f"its {_AXES[axis[a]]} shows {'minus ' if sign[a] < 0 else ''}{_AXES[a]} of the vehicle"
        for a in np.flatnonzero(is_wrong)
    )
    source = np.where(is_told, axis, np.arange(3))
    rates = rates[:, source] * np.where(is_told, sign, 1.0)
    weight, size, turn = np.ones(len(seen)), 1.0, np.zeros(3)
    for _ in range(4):
        size = max(float(np.sum(weight[:, None] * seen * rates) / np.sum(weight[:, None] * rates**2 + 1e-18)), 1e-6)
        rest = seen - size * rates
        if not swapped:
            J = -size * _skews(rates)
            H = np.einsum("n,nij,nik->jk", weight, J, J) + 1e-9 * np.eye(3)
            turn = np.linalg.solve(H, np.einsum("n,nij,ni->j", weight, J, rest))
            rest = rest - J @ turn
        square = np.sum(rest**2, axis=1)
        weight = 1.0 / (1.0 + square / (_TAIL * np.median(square) + 1e-18))
    return _Fit(square, 1.0 / size, turn, swapped, bool(is_told.any()))


def _correlation(seen: Float[np.ndarray, "n 3"], rates: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3 3"]:
    """Of every axis of the vehicle (rows) and of the sensor, where single false turns do not count much."""
    a, b = (np.clip(x, *np.percentile(x, [2, 98], axis=0)) for x in (seen, rates))
    a, b = (x / np.maximum(np.linalg.norm(x, axis=0), 1e-12) for x in (a, b))
    return a.T @ b


def _skews(v: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    zero = np.zeros(len(v))
    x, y, z = v.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _turns(found: ClockOfTurns) -> list[str]:
    """What the turns say; one cause at a time, as wrong units or axes leave nothing to say of the clock."""
    if not found.is_told:
        return []
    if found.swapped:
        return [f"axes of the gyroscope: {'; '.join(found.swapped)}; expected x ahead, y left, z up; turn the columns"]
    if _DEGREES / 2 < found.ratio < 2 * _DEGREES:
        return [f"turns are {found.ratio:.0f} times those of the cameras; expected rad/s: the unit is deg/s"]
    texts = []
    if abs(found.ratio - 1.0) > 0.1:
        texts.append(f"turns are {found.ratio:.2f} times those of the cameras; expected 1; check unit and focal length")
    least = max(_TELLING_S, _TELLING_SIGMAS * found.delay_sigma_s)
    if abs(found.delay_s) > least:
        texts.append(
            f"the clock is {1e3 * found.delay_s:+.0f} ms (sigma {1e3 * found.delay_sigma_s:.1f}) off that of the "
            f"cameras; expected none; take {found.delay_s:.3f} s off its times"
        )
    for axis, turn, sigma in zip(_AXES, found.turn_deg, found.turn_sigma_deg, strict=True):
        if abs(turn) > max(_TELLING_DEG, _TELLING_SIGMAS * sigma):
            texts.append(
                f"the sensor is turned by {turn:+.1f} deg (sigma {sigma:.1f}) about {axis} against the cameras; "
                "expected the axes of the vehicle; correct its mount or T_base_cam"
            )
    return texts
