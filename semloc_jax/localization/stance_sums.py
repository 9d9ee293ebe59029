"""How the vehicle stands on the road of the map, averaged over the way (room: localization; host).

In: height, roll and pitch of poses over the road. Out: StanceState; by how much a mount is tilted, by how much the
vehicle stands higher than its mounts say.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_SURFACE_M = 10.0
"""Way over which road and vehicle keep their own tilt: bumps, nods, what the map has of the slope."""
_MEMORY_M = 200.0
"""Way over which stances are averaged: a mount does not change while driving."""


class StanceState(NamedTuple):
    """Sums over independent stretches of road; heights [m], roll and pitch [rad]."""

    num: Float[np.ndarray, ""] = np.float64(0.0)
    total: Float[np.ndarray, "3"] = np.zeros(3)
    left_open: Float[np.ndarray, "3"] = np.zeros(3)
    """Variances that the surface of the map leaves open."""


def learned(
    stance: StanceState, measured: Float[np.ndarray, "3"], left_open: Float[np.ndarray, "3"], way_m: float
) -> StanceState:
    """The sums after one more look at how the vehicle stands on the road.

    Args:
        stance: Before.
        measured: Height [m], roll and pitch [rad] over the road of the map.
        left_open: Standard deviations of these that the surface of the map leaves open.
        way_m: Since the look before.
    """
    new = min(way_m / _SURFACE_M, 1.0) if stance.num > 0.0 else 1.0
    keep = np.exp(-way_m / _MEMORY_M)
    look = 1.0, np.asarray(measured), np.square(left_open)
    return StanceState(*(keep * old + new * one for old, one in zip(stance, look, strict=True)))


def height_m(stance: StanceState) -> float:
    """How much higher than its mounts say the vehicle stands over the road of the map, beyond what that leaves open."""
    num = max(float(stance.num), 1e-9)
    height = float(stance.total[0]) / num
    return float(np.copysign(max(abs(height) - np.sqrt(stance.left_open[0] / num), 0.0), height))


def mount_tilt_rad(stance: StanceState, own_rad: float, mount_sigma_deg: float) -> Float[np.ndarray, "2"]:
    """Roll and pitch of the cameras in their mount that the drive speaks for.

    A mount is tilted by the same in every place. Nods and bumps average out over the way; a crown that the map has not
    lies on one side all along and does not.

    Args:
        stance: What was seen.
        own_rad: Standard deviation of roll and pitch of a vehicle on a flat road.
        mount_sigma_deg: How far a mount may be off.
    """
    num = float(stance.num)
    if num <= 0.0:
        return np.zeros(2)
    mean, left_open = stance.total[1:] / num, stance.left_open[1:] / num
    variance, prior = left_open + own_rad**2 / max(num, 1.0), np.deg2rad(mount_sigma_deg) ** 2
    return mean * prior / (prior + variance)
