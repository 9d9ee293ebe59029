"""Whether measured poses and the motion between them fit each other (room: localization; host).

In: how each measured pose differs from the predicted one. Out: Innovations; how far a pose is in doubt where they do
not, and a sentence.
A clock that is late, an odometer that slips, times of frames that jump: each frame alone may pass, as its gate lets one
in a thousand through and no more is asked of it; several in a row do not. Errors of masks that stay for a while enter
with so large a variance that a filter may take them for new in every frame: squares are then smaller than they say, but
a sum of differences to one side is as large as they say, so the sum is held against them as well.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

_MEMORY_FRAMES = 5.0
_PROBABILITY = 0.9
"""Of a mean that small where covariances are exact; those of sound drives are careful, their means a third of it."""
_PROBABILITY_ALONE = 0.99
"""The same of one direction: a late clock shows along the way only, and the other five directions dilute it."""
_SIDE_FRAMES = 10.0
"""Memory of the sum to one side: a clock that is late makes a pose lag by less than its sigma in each frame."""
_SIDE_SIGMAS = 2.58
"""What one sum in a hundred exceeds where covariances are exact, as for squares. Sound drives: 2.2 at most."""
_SIDE_LEAST_FRAMES = 3.0
"""A sum of fewer independent frames is that of one outlier."""
_SIDE_MOST = 4.0
"""One frame counts as no more standard deviations."""
_DOF = 6
_MOST = 60.0
"""A frame counts as no more."""
_OF_PLANE = [0, 1, 5]
_WORDS = (
    "along the way: odometer or its clock",
    "across: direction of the cameras",
    "in heading: gyroscope or its clock",
)


class Innovations(NamedTuple):
    """Sums over the last frames, forgetting."""

    chi2: Float[np.ndarray, ""] = np.float64(0.0)
    """Squared innovations."""
    squares: Float[np.ndarray, "3"] = np.zeros(3)
    """Of forward, left and heading alone, over their variances."""
    away: Float[np.ndarray, "3"] = np.zeros(3)
    """Squared differences themselves [m^2, m^2, rad^2]."""
    num: Float[np.ndarray, ""] = np.float64(0.0)
    side: Float[np.ndarray, "3"] = np.zeros(3)
    """Sums, signed, of forward, left and heading over their standard deviations."""
    side_variance: Float[np.ndarray, ""] = np.float64(0.0)
    """Of these sums where covariances are exact."""
    last: Float[np.ndarray, "2"] = np.zeros(2)
    """Difference along the way in the last frame [m], and its variance [m^2]."""


def learned(
    state: Innovations, chi2: float, difference: Float[np.ndarray, "6"], covariance: Float[np.ndarray, "6 6"]
) -> Innovations:
    """The sums after one more frame that measured a pose; what is no number says nothing.

    Args:
        state: Before.
        chi2: Squared distance of the measured pose to the predicted one.
        difference: Measured pose as seen from the predicted one (right tangent).
        covariance: Of the difference.
    """
    away = difference[_OF_PLANE]
    sigmas = away / np.sqrt(np.maximum(np.diagonal(covariance)[_OF_PLANE], 1e-18))
    if not (np.isfinite(chi2) and np.isfinite(sigmas).all()):
        return state
    squares, to_side = np.minimum(sigmas**2, _MOST), np.clip(sigmas, -_SIDE_MOST, _SIDE_MOST)
    keep, longer = 1.0 - 1.0 / _MEMORY_FRAMES, 1.0 - 1.0 / _SIDE_FRAMES
    sums = zip(
        (keep, keep, keep, keep, longer, longer**2),
        state[:-1],
        (min(chi2, _MOST), squares, away**2, 1.0, to_side, 1.0),
        strict=True,
    )
    last = np.array([difference[0], covariance[0, 0]], np.float64)
    return Innovations(*(np.asarray(share * old + new, np.float64) for share, old, new in sums), last)


def along(state: Innovations) -> tuple[float, float, float]:
    """Of the last frames along the way: how many they are, mean squared difference of measured and predicted pose
    [m^2], and the mean of the same over its variance."""
    num = float(state.num)
    asked = max(num, 1e-9)
    return num, float(state.away[0]) / asked, float(state.squares[0]) / asked


class Doubt(NamedTuple):
    """How far a pose may be off that masks or motion alone have right."""

    lateral_m: float
    longitudinal_m: float
    heading_deg: float
    cause: str


def doubts(state: Innovations) -> tuple[Doubt, ...]:
    """The doubt where the last frames fit the motion between them worse than chance lets them: either side may be
    right, so the pose is as far off as they differ."""
    num = float(state.num)
    if num < 2.0:
        return ()
    mean, alone = float(state.chi2) / num, state.squares / num
    most = float(chdtri(_DOF * num, 1.0 - _PROBABILITY)) / num
    most_alone = float(chdtri(num, 1.0 - _PROBABILITY_ALONE)) / num
    variance = float(state.side_variance)
    to_side = np.abs(state.side) / np.sqrt(variance) if variance >= _SIDE_LEAST_FRAMES else np.zeros(3)
    worst = int(np.argmax(alone))
    if mean > most:
        size = f"squared innovations {mean:.0f}, at most {most:.0f}"
    elif alone[worst] > most_alone:
        size = f"squared innovations {alone[worst]:.0f}, at most {most_alone:.0f}"
    elif to_side.max() > _SIDE_SIGMAS:
        worst = int(np.argmax(to_side))
        size = f"differences to one side, {to_side[worst]:.1f} standard deviations of their sum"
    else:
        return ()
    ahead_m, left_m, turn_rad = np.sqrt(state.away / num).tolist()
    told = f"masks and motion do not fit each other ({size}), {_WORDS[worst]}"
    return (Doubt(left_m, ahead_m, float(np.degrees(turn_rad)), told),)
