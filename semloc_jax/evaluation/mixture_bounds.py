"""Bounds of an error that has one of several causes (room: evaluation; host).

In: what the error is likely to be under each cause, and how probable the cause is. Out: bounds at a stated risk, and
the probability that the error is beyond given limits.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import stdtr

RISK = 1e-3
"""Probability for each pose that any of its three errors is larger than its bound. Ours."""
LEAST_LEVELS = (0.15, 0.25, 0.3)
"""What a fault may do that shows in nothing, as maps are surveyed and cameras are mounted to centimetres and tenths of
a degree: lateral [m], longitudinal [m], heading [deg]. No protection level is smaller. Ours."""
_HALVINGS = 32
"""A bound of a metre to less than a nanometre."""


class Causes(NamedTuple):
    """The error under each of several causes: Student's t about a mean; directions are columns.

    Attributes:
        probability: of the causes, which exclude each other.
        mean: of the error.
        sigma: scale of the error about it.
        freedom: degrees of freedom that each scale is known with.
    """

    probability: Float[np.ndarray, " n"]
    mean: Float[np.ndarray, "n 3"]
    sigma: Float[np.ndarray, "n 3"]
    freedom: Float[np.ndarray, "n 3"]


def beyond(causes: Causes, limits: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Probability that the error of each direction is larger than its limit, whatever its sign."""
    sigma = np.maximum(causes.sigma, 1e-12)
    above, below = (stdtr(causes.freedom, (side * causes.mean - limits) / sigma) for side in (1.0, -1.0))
    return causes.probability @ (above + below)


def bounds(causes: Causes, risk: float = RISK) -> Float[np.ndarray, "3"]:
    """The smallest bounds that the errors exceed with at most this risk, shared equally by the three directions;
    infinite where a cause is not finite.

    >>> from semloc_jax.evaluation.mixture_bounds import Causes, bounds
    >>> sound = Causes(np.ones(1), np.zeros((1, 3)), np.full((1, 3), 0.1), np.full((1, 3), np.inf))
    >>> bounds(sound, risk=3 * 0.0455).round(2).tolist()  # two standard deviations
    [0.2, 0.2, 0.2]
    """
    if not all(np.isfinite(part).all() for part in (causes.probability, causes.mean, causes.sigma)):
        return np.full(3, np.inf)
    share = risk / 3.0
    low, high = np.zeros(3), np.ones(3)
    while (is_short := beyond(causes, high) > share).any():
        high = np.where(is_short, 2.0 * high, high)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        is_short = beyond(causes, middle) > share
        low, high = np.where(is_short, middle, low), np.where(is_short, high, middle)
    return high
