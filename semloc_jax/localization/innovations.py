"""Whether measured poses and the motion between them fit each other (room: localization; host).

In: how each measured pose differs from the predicted one. Out: Innovations; a sentence where they do not.
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
    squares = (difference**2 / np.maximum(np.diagonal(covariance), 1e-18))[_OF_PLANE]
    if not (np.isfinite(chi2) and np.isfinite(squares).all()):
        return state
    new = (min(chi2, _MOST), np.minimum(squares, _MOST), 1.0)
    keep = 1.0 - 1.0 / _MEMORY_FRAMES
    return Innovations(*(np.asarray(keep * old + one, np.float64) for old, one in zip(state, new, strict=True)))


def doubts(state: Innovations) -> tuple[str, ...]:
    """A sentence where the last frames fit the motion between them worse than chance lets them."""
    num = float(state.num)
    if num < 2.0:
        return ()
    mean, most = float(state.chi2) / num, float(chdtri(_DOF * num, 1.0 - _PROBABILITY)) / num
    if mean <= most:
        return ()
    where = _WORDS[int(np.argmax(state.squares))]
    return (f"masks and motion do not fit each other (squared innovations {mean:.0f}, at most {most:.0f}), {where}",)
