"""How far the nose of the vehicle dips, by lane lines that stay parallel in the top view (room: perception; host).

In: lines on the road as a level vehicle sees them, the places of their cameras. Out: pitch [rad], positive nose down.
Road-SLAM (IV 2017) adapts its inverse perspective mapping to the road in view: parallel lines keep their distance. All
lines are fitted as one parabola with an offset for each; the pitch that leaves least, with a prior of 0.3 deg, is
taken.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_PRIOR_RAD = np.deg2rad(0.3)
_MOST_RAD, _STEP_RAD = np.deg2rad(1.5), np.deg2rad(0.05)
_LINE_SIGMA_M = 0.05
"""Of a metre of line in a mask; ours."""
_LEAST_APART_M, _LEAST_LENGTH_M = 1.5, 4.0
"""Lines nearer together, or with a shorter stretch beside each other, do not tell the pitch; ours."""


class LaneLine(NamedTuple):
    """A line along the road, as a camera of a level vehicle sees it."""

    xy_base: Float[np.ndarray, "n 2"]
    """Places in the top view [m]."""
    camera_base: Float[np.ndarray, " 3"]
    """Place of the camera [m]."""


def road_pitch(lines: Sequence[LaneLine]) -> float:
    """The pitch of the vehicle against the road [rad]; 0 where the lines do not tell it.

    Args:
        lines: lane lines, each with one point for about every metre of it.
    """
    spans = [(line.xy_base[:, 0].min(), line.xy_base[:, 0].max(), line.xy_base[:, 1].mean()) for line in lines]
    told = any(
        abs(a[2] - b[2]) >= _LEAST_APART_M and min(a[1], b[1]) - max(a[0], b[0]) >= _LEAST_LENGTH_M
        for i, a in enumerate(spans)
        for b in spans[:i]
    )
    if not told:
        return 0.0
    pitches = np.arange(-_MOST_RAD, _MOST_RAD + 0.5 * _STEP_RAD, _STEP_RAD)
    costs = np.array([_apart(lines, pitch) + 0.5 * (pitch / _PRIOR_RAD) ** 2 for pitch in pitches])
    best = int(np.clip(np.argmin(costs), 1, len(costs) - 2))
    before, at, after = costs[best - 1 : best + 2]
    curve = before - 2 * at + after
    return float(pitches[best] + (0.5 * (before - after) / curve * _STEP_RAD if curve > 0.0 else 0.0))


def levelled_points(
    xy_base: Float[np.ndarray, "n 2"], camera_base: Float[np.ndarray, " 3"], pitch_rad: float
) -> Float[np.ndarray, "n 2"]:
    """Places that a level vehicle would see, for one whose nose dips [m]; NaN for what is no road then."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    R = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    place, camera = np.column_stack([xy_base, np.zeros(len(xy_base))]) @ R.T, R @ camera_base
    fall = camera[2] - place[:, 2]
    reach = np.where(fall > 1e-6, camera[2] / np.where(fall > 1e-6, fall, 1.0), np.nan)
    return camera[:2] + reach[:, None] * (place[:, :2] - camera[:2])


def _apart(lines: Sequence[LaneLine], pitch_rad: float) -> float:
    """Cost of the lines as parallel parabolas [nats]."""
    moved = [levelled_points(line.xy_base, line.camera_base, pitch_rad) for line in lines]
    x, y = np.concatenate(moved).T
    which = np.repeat(np.arange(len(lines)), [len(part) for part in moved])
    A = np.column_stack([which[:, None] == np.arange(len(lines)), x, x**2]).astype(np.float64)
    good = np.isfinite(x)
    solution, *_ = np.linalg.lstsq(A[good], y[good], rcond=None)
    return 0.5 * float(np.sum((A[good] @ solution - y[good]) ** 2)) / _LINE_SIGMA_M**2
