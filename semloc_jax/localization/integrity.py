"""Bounds of the error of a pose at a stated risk, and whether they are small enough (room: localization; host).

In: covariance of a pose. Out: ProtectionLevels, reasons.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from semloc_jax.evaluation.metrics import ALERT_LIMITS, ErrorLimit

_DIRECTIONS = [1, 0, 5]
"""Lateral, longitudinal and heading in a tangent."""
_MOST_AVERAGED = 1000.0


@dataclass(frozen=True)
class IntegrityConfig:
    """How protection levels are made. All values but the alert limits are ours."""

    risk: float = 1e-3
    """Probability for each frame that any of the three errors is larger than its level."""
    overbound: float = 1.0
    """Further factor on the standard deviations, for tails that are heavier than those of a Gaussian."""
    correlation_m: float = 1.0
    """Way over which the errors of measured poses are the same beyond what their covariance says already: the same
    dashes and poles, with the same errors of the map and of the mask borders, stay in view."""
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


def protection_levels(
    covariance: Float[np.ndarray, "6 6"],
    config: IntegrityConfig,
    measured: Float[np.ndarray, "6 6"] | None = None,
    way_m: float = 0.0,
) -> ProtectionLevels:
    """Bounds of the lateral [m], longitudinal [m] and heading [deg] error of a fused pose.

    The risk is shared equally by the three directions. Measurements that were taken for independent are not: the sigma
    grows by `overbound_of_correlation`.

    Args:
        covariance: Of the right tangent (x, y, z, roll, pitch, yaw) of the fused pose.
        config: Risk, correlation, overbounding factor.
        measured: Covariance of the pose that the frame measured; None where it measured none.
        way_m: Way from one measured pose to the next [m].
    """
    variance = np.maximum(np.diagonal(covariance), 0.0)[_DIRECTIONS]
    factor = np.full(3, config.overbound)
    if measured is not None:
        num_averaged = np.diagonal(measured)[_DIRECTIONS] / np.maximum(variance, 1e-12)
        factor *= [overbound_of_correlation(way_m, config.correlation_m, num) for num in num_averaged]
    sigma = factor * np.sqrt(variance)
    levels = -ndtri(config.risk / 6.0) * sigma
    return ProtectionLevels(float(levels[0]), float(levels[1]), float(np.degrees(levels[2])))


def beyond_alert(levels: ProtectionLevels, limit: ErrorLimit) -> tuple[str, ...]:
    """A reason for each protection level that is beyond its alert limit or is no number."""
    limits = (limit.lateral_m, limit.longitudinal_m, limit.heading_deg)
    names = (("lateral", "m"), ("longitudinal", "m"), ("heading", "deg"))
    return tuple(
        f"{name} protection level {level:.2f} {unit} exceeds {bound:g} {unit}"
        for (name, unit), level, bound in zip(names, levels, limits, strict=True)
        if not level <= bound
    )


def overbound_of_correlation(way_m: float, correlation_m: float, num_averaged: float) -> float:
    """Factor on the sigma of a fused pose whose measurements are correlated over a length.

    An average of n measurements with correlation exp(-way / length) between neighbours has the variance
    (1 + 2 sum_k (1 - k / n) rho^k) / n; the filter states 1 / n.

    Args:
        way_m: Way between neighbouring measurements [m].
        correlation_m: Length over which their errors are the same [m].
        num_averaged: Measurements that the fused pose is an average of: variance of one over the fused variance.
    """
    num = float(np.clip(num_averaged, 1.0, _MOST_AVERAGED))
    lags = np.arange(1, int(np.ceil(num)))
    rho = np.exp(-way_m / max(correlation_m, 1e-9))
    return float(np.sqrt(1.0 + 2.0 * np.sum((1.0 - lags / num) * rho**lags)))
