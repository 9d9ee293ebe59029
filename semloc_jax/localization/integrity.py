"""Bounds of the error of a pose at a stated risk, and whether they are small enough (room: localization; host).

In: covariance of a pose. Out: ProtectionLevels, reasons.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit

from semloc_jax.evaluation.metrics import ALERT_LIMITS, ErrorLimit
from semloc_jax.evaluation.mixture_bounds import RISK, Causes, beyond

_DIRECTIONS = [1, 0, 5]
"""Lateral, longitudinal and heading in a tangent."""
LEVEL_UNITS = np.array([1.0, 1.0, np.degrees(1.0)])
"""Of lateral, longitudinal and heading in levels [m, m, deg] for those in tangents [m, m, rad]."""
_LEAST_PART = 0.01
"""No direction is left with less of the risk: tails are not known beyond."""
_NUM_PARTS, _HALVINGS = 25, 30
"""How finely risks are shared: to a thousandth, which the sum is then freed of."""


@dataclass(frozen=True)
class IntegrityConfig:
    """How protection levels are made. All values but the alert limits are ours."""

    risk: float = RISK
    """Probability for each frame that any of the three errors is larger than its level."""
    alert_limits: str = ALERT_LIMITS[0].name
    """Name of the alert limits: local_street or freeway."""

    @property
    def limit(self) -> ErrorLimit:
        """The alert limits."""
        return next(limit for limit in ALERT_LIMITS if limit.name == self.alert_limits)


class ProtectionLevels(NamedTuple):
    """What the errors do not exceed, but for the stated risk."""

    lateral_m: float
    longitudinal_m: float
    heading_deg: float


def map_sigmas(map_sigma_m: float, map_sigma_rad: float) -> Float[np.ndarray, "3"]:
    """Standard deviations lateral [m], longitudinal [m] and of the heading [rad] that the map leaves open.

    All that is near may be off by the same vector. A drive cannot measure it, so the maker of the map states it.

    Args:
        map_sigma_m: Standard deviation of the place of what is near, in every direction [m].
        map_sigma_rad: Standard deviation of its direction [rad].
    """
    return np.array([map_sigma_m, map_sigma_m, map_sigma_rad])


def protection_levels(
    covariance: Float[np.ndarray, "6 6"],
    freedom: Float[np.ndarray, "3"],
    of_map: Float[np.ndarray, "3"],
    room: Float[np.ndarray, "3"],
    config: IntegrityConfig,
) -> ProtectionLevels:
    """Bounds of the lateral [m], longitudinal [m] and heading [deg] error of a fused pose.

    How large errors are is known by few of them: divided by such a sigma they follow Student's t, whose tails are heavy
    at first (1.5 times those of a Gaussian with ten degrees of freedom) and become lighter as the drive says more. The
    map's part is stated, not learned.

    The three directions share the risk equally, unless one of them has no room that way: an error across that stays
    below its limit all but surely leaves its risk to the others.

    Args:
        covariance: Of the right tangent (x, y, z, roll, pitch, yaw) of the fused pose in the map.
        freedom: Degrees of freedom that its scale stands on: lateral, longitudinal, heading.
        of_map: From `map_sigmas`.
        room: Up to where each bound is of use: lateral [m], longitudinal [m], heading [deg].
        config: Risk.
    """
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)[_DIRECTIONS])

    def bounds(share: np.ndarray) -> np.ndarray:
        """For risks on either side."""
        return np.hypot(stdtrit(freedom, 1.0 - share) * sigma, -ndtri(share) * of_map) * LEVEL_UNITS

    levels = bounds(np.full(3, config.risk / 6.0))
    if not (levels <= room).all() and (room > 0.0).all():
        other = bounds(_shares(bounds, room, config.risk / 2.0))
        levels = other if (other <= room).all() else levels
    return ProtectionLevels(*levels.tolist())


def _shares(
    bounds: Callable[[np.ndarray], np.ndarray], room: Float[np.ndarray, "3"], risk: float
) -> Float[np.ndarray, "3"]:
    """The parts of a risk with which the bound that fills most of its room fills as little of it as can be."""
    parts = risk * np.geomspace(_LEAST_PART, 1.0, _NUM_PARTS)
    filled = np.array([bounds(np.full(3, part)) for part in parts]) / room
    low, high = 0.0, float(filled.max())
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        # Bounds fall as risks grow, and interpolation wants them to rise.
        shares = np.exp([np.interp(middle, column[::-1], np.log(parts)[::-1]) for column in filled.T])
        low, high = (middle, high) if shares.sum() > risk else (low, middle)
    return risk * shares / shares.sum()


def misleading(
    covariance: Float[np.ndarray, "6 6"],
    freedom: Float[np.ndarray, "3"],
    of_map: Float[np.ndarray, "3"],
    fault: Float[np.ndarray, "3"],
    limit: ErrorLimit,
) -> float:
    """Probability that an error is beyond its alert limit; the first three arguments as `protection_levels`.

    Args:
        fault: How far the worst suspected fault moves the pose: lateral [m], longitudinal [m], heading [deg].
        limit: The alert limits.
    """
    variance = np.maximum(np.diagonal(covariance), 1e-18)[_DIRECTIONS]
    total = variance + of_map**2
    # What is stated has the tails of a Gaussian (Welch and Satterthwaite).
    scale = LEVEL_UNITS * np.sqrt(total)
    causes = Causes(np.ones(1), fault[None], scale[None], (freedom * (total / variance) ** 2)[None])
    limits = np.array([limit.lateral_m, limit.longitudinal_m, limit.heading_deg])
    return float(min(beyond(causes, limits).sum(), 1.0))


def beyond_alert(levels: ProtectionLevels, limit: ErrorLimit) -> tuple[str, ...]:
    """A reason for each protection level that is beyond its alert limit or is no number."""
    limits = (limit.lateral_m, limit.longitudinal_m, limit.heading_deg)
    names = (("lateral", "m"), ("longitudinal", "m"), ("heading", "deg"))
    return tuple(
        f"{name} protection level {level:.2f} {unit} exceeds {bound:g} {unit}"
        for (name, unit), level, bound in zip(names, levels, limits, strict=True)
        if not level <= bound
    )
