"""Whether the distortion of the lenses is stated with the wrong sign (room: localization; host).

In: frames solved with lenses of the other sign. Out: SignState; whether the drive has spoken against it yet.
Calibrations are exchanged with either sign. A lens with the wrong one bends the road smoothly: each frame fits,
decimetres off. The fault is known as a whole before the first frame, so it is solved from the start, and levels reach
as far as it would move the pose until the drive has told which of both lenses it is.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class SignState(NamedTuple):
    """Sums over all frames that were asked: no lens changes its sign while driving, and where little is in view each
    frame says next to nothing."""

    num: Float[np.ndarray, ""] = np.float64(0.0)
    gain: Float[np.ndarray, ""] = np.float64(0.0)
    """By how much they fit better with the other sign [nats]."""
    moved: Float[np.ndarray, "3"] = np.zeros(3)
    """How far their poses move then: forward [m], left [m], heading [rad]."""


def learned(sign: SignState, gain_nats: float, moved: Float[np.ndarray, "3"]) -> SignState:
    """The sums after one more frame; what is no number says nothing.

    Args:
        sign: Before.
        gain_nats: By how much it fits better with the other sign.
        moved: How far its pose moves: forward [m], left [m], heading [rad].
    """
    if not (np.isfinite(gain_nats) and np.isfinite(moved).all()):
        return sign
    return SignState(*(old + new for old, new in zip(sign, (1.0, gain_nats, moved), strict=True)))


def nats(sign: SignState, share: float) -> float:
    """By how much the drive is better explained with the other sign [nats]; `share` of what a frame says is new."""
    return share * float(sign.gain)


def mean_move(sign: SignState) -> Float[np.ndarray, "3"]:
    """How far the pose would be off."""
    return np.asarray(sign.moved / max(float(sign.num), 1e-9))
