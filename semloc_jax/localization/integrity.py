"""Bounds of the error of a pose at a stated risk, and whether they are small enough (room: localization; host).

In: covariance of a pose. Out: ProtectionLevels, reasons.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit

from semloc_jax.evaluation.metrics import ALERT_LIMITS, ErrorLimit
from semloc_jax.evaluation.mixture_bounds import RISK, Causes, beyond

_DIRECTIONS = [1, 0, 5]
"""Lateral, longitudinal and heading in a tangent."""


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
    config: IntegrityConfig,
) -> ProtectionLevels:
    """Bounds of the lateral [m], longitudinal [m] and heading [deg] error of a fused pose.

    The risk is shared equally by the three directions. How large errors are is known by few of them: divided by such a
    sigma they follow Student's t, whose tails are heavy at first (1.5 times those of a Gaussian with ten degrees of
    freedom) and become lighter as the drive says more. The map's part is stated, not learned.

    Args:
        covariance: Of the right tangent (x, y, z, roll, pitch, yaw) of the fused pose in the map.
        freedom: Degrees of freedom that its scale stands on: lateral, longitudinal, heading.
        of_map: From `map_sigmas`.
        config: Risk.
    """
    share = config.risk / 6.0
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)[_DIRECTIONS])
    levels = np.hypot(stdtrit(freedom, 1.0 - share) * sigma, -ndtri(share) * of_map)
    return ProtectionLevels(float(levels[0]), float(levels[1]), float(np.degrees(levels[2])))


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
    scale = np.array([1.0, 1.0, np.degrees(1.0)]) * np.sqrt(total)
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
