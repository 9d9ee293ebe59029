"""Whether measured poses and the motion between them fit each other (room: localization; host).

In: how each measured pose differs from the predicted one. Out: Innovations; how far a pose is in doubt where they do
not, and a sentence.
A clock that is late, an odometer that slips, times of frames that jump: each frame alone may pass, as its gate lets one
in a thousand through and no more is asked of it; several in a row do not.
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
    away = np.square(difference)[_OF_PLANE]
    squares = away / np.maximum(np.diagonal(covariance)[_OF_PLANE], 1e-18)
    if not (np.isfinite(chi2) and np.isfinite(squares).all()):
        return state
    new = (min(chi2, _MOST), np.minimum(squares, _MOST), away, 1.0)
    keep = 1.0 - 1.0 / _MEMORY_FRAMES
    return Innovations(*(np.asarray(keep * old + one, np.float64) for old, one in zip(state, new, strict=True)))


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
    worst = int(np.argmax(alone))
    if mean <= most and alone[worst] <= most_alone:
        return ()
    ahead_m, left_m, turn_rad = np.sqrt(state.away / num).tolist()
    size = f"{mean:.0f}, at most {most:.0f}" if mean > most else f"{alone[worst]:.0f}, at most {most_alone:.0f}"
    told = f"masks and motion do not fit each other (squared innovations {size}), {_WORDS[worst]}"
    return (Doubt(left_m, ahead_m, float(np.degrees(turn_rad)), told),)
