"""Protection levels of one frame, and how probable it is that it misleads (room: alignment; host).

In: places of a frame with what may be wrong, the map, the mounts. Out: FrameLevels.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.fault_modes import PLANE, FaultConfig, probabilities
from semloc_jax.alignment.result import FoundModes
from semloc_jax.cameras import Rig
from semloc_jax.evaluation.metrics import ErrorLimit
from semloc_jax.evaluation.mixture_bounds import LEAST_LEVELS, Causes, beyond, bounds
from semloc_jax.geometry import rigid
from semloc_jax.residuals.noise import POSE_FREEDOM

AS_LEVELS = [1, 0, 2]
"""Lateral, longitudinal, heading among forward, left, heading."""
_TO_DEG = np.array([1.0, 1.0, np.degrees(1.0)])


class FrameLevels(NamedTuple):
    """What the errors of a frame do not exceed but for the stated risk, and the risk itself.

    Attributes:
        protection: bounds of the lateral [m], longitudinal [m] and heading [deg] error.
        misleading: probability that one of them is beyond its alert limit.
    """

    protection: tuple[float, float, float] = (np.inf, np.inf, np.inf)
    misleading: float = 1.0


def mount_variance(rig: Rig, config: FaultConfig) -> Float[np.ndarray, "3"]:
    """Variances of forward, left [m^2] and heading [rad^2] of a vehicle whose cameras are turned in their mounts.

    It is turned with them, about them.
    """
    x, y, z = np.asarray(rig.T_base_cam, np.float64)[:, :3, 3].mean(axis=0)
    return np.deg2rad(config.mount_sigma_deg) ** 2 * np.array([y**2 + z**2, x**2 + z**2, 1.0])


def levels_of(found: FoundModes, shared: Float[np.ndarray, "3"], limit: ErrorLimit) -> FrameLevels:
    """The levels of the best place: of its noise, of each fault, of other places, each with its probability.

    Args:
        found: Places and faults.
        shared: Variances that map and mounts leave open for all of them: forward, left [m^2], heading [rad^2].
        limit: The alert limits.
    """
    if not found.modes:
        return FrameLevels()
    best, plane = found.modes[0], np.ix_(PLANE, PLANE)
    sound = best.covariance[plane] if found.sound is None else found.sound
    shares = best.weight * probabilities(found.faults)
    rows = [(best.weight - shares.sum(), np.zeros(3), sound)]
    rows += [(share, fault.moved, fault.covariance) for share, fault in zip(shares, found.faults, strict=True)]
    for mode in found.modes[1:]:
        away = rigid.log(rigid.inverse(best.T_map_base) @ mode.T_map_base)[list(PLANE)]
        rows.append((mode.weight, away, mode.covariance[plane]))
    probability, mean, covariance = (np.array(column, np.float64) for column in zip(*rows, strict=True))
    own = np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 1e-18)
    sigma, scale = np.sqrt(own + shared)[:, AS_LEVELS], _TO_DEG[AS_LEVELS]
    # What is stated has the tails of a Gaussian (Welch and Satterthwaite).
    freedom = POSE_FREEDOM * ((own + shared) / own)[:, AS_LEVELS] ** 2
    causes = Causes(probability, scale * mean[:, AS_LEVELS], scale * sigma, freedom)
    limits = np.array([limit.lateral_m, limit.longitudinal_m, limit.heading_deg])
    levels = np.maximum(bounds(causes), LEAST_LEVELS)
    return FrameLevels(tuple(levels.tolist()), min(float(beyond(causes, limits).sum()), 1.0))
