"""Inertial samples between two image times, as steps of a trapezoid rule (room: fusion; host).

In: an Imu, two times. Out: Steps for `residuals.preintegration.preintegrate`, of a fixed length.
Samples are joined by straight lines and read at the image times. Held samples would be wrong by half a step of turn
and push: on a noise-free drive 15 times the error of the trapezoid.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Imu
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid

_LONGEST_GAP_S = 0.2
"""Rates and forces are not guessed over a longer gap; our choice."""


class Steps(NamedTuple):
    """Means over short steps; steps of length 0 are padding."""

    gyro_radps: Float[np.ndarray, "n 3"]
    accel_mps2: Float[np.ndarray, "n 3"]
    """In the axes of the base at the begin of each step."""
    step_s: Float[np.ndarray, " n"]


def steps_between(imu: Imu, from_s: float, to_s: float, capacity: int) -> Steps:
    """The motion between two times in at most `capacity` steps.

    Raises:
        SemlocError: the times are not covered by samples, or there are more steps than fit.
    """
    after = int(np.searchsorted(imu.time_s, from_s, "right"))
    # A log of minutes is not looked through for the samples of a tenth of a second.
    end = int(np.searchsorted(imu.time_s, to_s))
    knots = np.concatenate([[from_s], imu.time_s[after:end], [to_s]])
    if after < 1 or to_s > imu.time_s[-1] + _LONGEST_GAP_S or _largest_gap(imu, from_s, to_s) > _LONGEST_GAP_S:
        raise SemlocError(
            f"imu: no samples within {_LONGEST_GAP_S} s between {from_s:.3f} and {to_s:.3f} s; expected a log "
            "without gaps over the whole drive; leave those frames out"
        )
    if len(knots) - 1 > capacity:
        raise SemlocError(f"imu: {len(knots) - 1} samples between two images; expected at most {capacity}")
    near = slice(after - 1, end + 1)
    gyro, force = (
        np.stack([np.interp(knots, imu.time_s[near], column) for column in rows[near].T], axis=1)
        for rows in (imu.gyro_radps, imu.accel_mps2)
    )
    steps = steps_of(knots, gyro, force)
    pad = capacity - len(steps.step_s)
    return Steps(*(np.pad(rows, ((0, pad), *((0, 0),) * (rows.ndim - 1))) for rows in steps))


def steps_of(
    knots_s: Float[np.ndarray, " k"], gyro_radps: Float[np.ndarray, "k 3"], accel_mps2: Float[np.ndarray, "k 3"]
) -> Steps:
    """The steps between neighbouring times, with the rates and forces at these times."""
    step_s = np.diff(knots_s)
    rate = 0.5 * (gyro_radps[1:] + gyro_radps[:-1])
    turn = rigid.exp(np.concatenate([np.zeros_like(rate), rate * step_s[:, None]], axis=1))[:, :3, :3]
    return Steps(rate, 0.5 * (accel_mps2[:-1] + np.einsum("nij,nj->ni", turn, accel_mps2[1:])), step_s)


def capacity_for(imu: Imu, time_s: Float[np.ndarray, " n"]) -> int:
    """Steps that are enough for every interval between increasing times, in units of 8 so that programs are shared."""
    count = np.diff(np.searchsorted(imu.time_s, time_s)) + 2
    return int(-(-int(count.max(initial=2)) // 8) * 8)


def rotation_between(steps: Steps, bias_radps: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """R_from_to of the base by the gyroscope alone."""
    R = np.eye(3)
    turns = (steps.gyro_radps - bias_radps) * steps.step_s[:, None]
    for turn in rigid.exp(np.concatenate([np.zeros_like(turns), turns], axis=1))[steps.step_s > 0, :3, :3]:
        R = R @ turn
    return R


def _largest_gap(imu: Imu, from_s: float, to_s: float) -> float:
    first = max(int(np.searchsorted(imu.time_s, from_s, "right")) - 1, 0)
    last = min(int(np.searchsorted(imu.time_s, to_s)) + 1, len(imu.time_s))
    return float(np.diff(imu.time_s[first:last]).max(initial=0.0))
