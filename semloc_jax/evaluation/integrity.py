"""Whether a localizer knows how wrong it is: NEES, sigma coverage, Stanford counts (room: evaluation; host).

In: errors with the covariances and protection levels that were stated for them. Out: NeesReport, StanfordCounts.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtri

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.metrics import Metric


@dataclass(frozen=True)
class NeesReport:
    """Mean normalised estimation error squared, and where it should lie.

    Args:
        mean: over the frames, divided by the degrees of freedom: 1 where the covariance is right, more where it is too
            small.
        low: begin of the band that the mean is in with the stated probability if the covariance is right.
        high: its end.
        num_independent: frames that were counted as independent.
    """

    mean: float
    low: float
    high: float
    num_independent: float


def normalised_squares(
    errors: Float[np.ndarray, "n k"], covariance: Float[np.ndarray, "n k k"]
) -> Float[np.ndarray, " n"]:
    """e^T C^-1 e of every frame."""
    return np.einsum("ni,ni->n", errors, np.linalg.solve(covariance, errors[..., None])[..., 0])


def nees(
    squares: Float[np.ndarray, " n"], dof: int, probability: float = 0.95, num_independent: float | None = None
) -> NeesReport:
    """The normalised estimation error squared of a run.

    Args:
        squares: One value for each frame, see `normalised_squares`.
        dof: Degrees of freedom of each.
        probability: Of the band.
        num_independent: Frames that count as independent; None for all. Errors of successive frames share the errors of
            the map and of the masks: the band of a drive is that of its independent stretches.

    Raises:
        SemlocError: there are no frames.
    """
    if len(squares) == 0:
        raise SemlocError("nees: no frames with truth and covariance; expected at least one")
    num = float(len(squares)) if num_independent is None else float(num_independent)
    tail = 0.5 * (1.0 - probability)
    low, high = chdtri(dof * num, [1.0 - tail, tail]) / (dof * num)
    return NeesReport(float(np.mean(squares)) / dof, float(low), float(high), num)


def independent_frames(errors: Float[np.ndarray, "n k"]) -> float:
    """How many independent frames a series of correlated errors is worth: n / (1 + 2 sum of autocorrelations).

    The sum ends where the autocorrelation, the mean over the columns, first falls below 0.05 (our choice).
    """
    num = len(errors)
    scale = np.sqrt(np.mean(errors**2, axis=0))
    scaled = errors / np.where(scale > 0.0, scale, 1.0)
    total = 0.0
    for lag in range(1, num):
        correlation = float(np.mean(np.sum(scaled[lag:] * scaled[:-lag], axis=0) / num))
        if correlation < 0.05:
            break
        total += correlation
    return num / (1.0 + 2.0 * total)


def sigma_coverage(errors: Float[np.ndarray, " n"], sigma: Float[np.ndarray, " n"], num_sigmas: float = 3.0) -> float:
    """Share of frames whose error is at most `num_sigmas` stated standard deviations; 0.9973 for three and a Gaussian.

    nan where there are no frames.
    """
    return float(np.mean(np.abs(errors) <= num_sigmas * sigma)) if len(errors) else float("nan")


class HourlyRisk(NamedTuple):
    """How often a drive misleads in an hour of poses that it offers.

    Attributes:
        stated: expected number of times, by the probabilities that were stated.
        seen: stretches of frames with an error beyond an alert limit.
        below: what the true rate is below with a probability of 95 % (Poisson), as a short drive says little.
        hours: of poses that were offered.
    """

    stated: float
    seen: float
    below: float
    hours: float


def hourly_risk(
    misleading: Float[np.ndarray, " n"], is_wrong: Bool[np.ndarray, " n"], step_s: float, num_independent: float
) -> HourlyRisk:
    """What offered poses come to in an hour.

    Neighbouring frames are wrong together: a risk of one frame counts once for each independent one, and a stretch of
    wrong ones is one event.

    Args:
        misleading: Stated probability of each offered frame.
        is_wrong: Whether its error is beyond an alert limit.
        step_s: Time between frames [s].
        num_independent: Frames that these are worth; see `independent_frames`.

    Raises:
        SemlocError: no frame was offered.
    """
    if len(misleading) == 0:
        raise SemlocError("hourly risk: no frames that were offered; expected at least one")
    hours = len(misleading) * step_s / 3600.0
    events = int(np.sum(np.diff(np.concatenate([[False], is_wrong]).astype(int)) > 0))
    stated = float(np.mean(misleading)) * num_independent
    most = 0.5 * float(chdtri(2 * (events + 1), 0.05))
    return HourlyRisk(stated / hours, events / hours, most / hours, hours)


@dataclass(frozen=True)
class StanfordCounts:
    """Frames by error, protection level and alert limit: the fields of the Stanford diagram.

    Args:
        available: the level is within the limit and bounds the error.
        unavailable: the level is beyond the limit and bounds the error: the system itself says that it is not safe.
        misleading: the error is larger than the level, but the two lie on the same side of the limit.
        hazardous: the level is within the limit, the error beyond it.
    """

    available: int
    unavailable: int
    misleading: int
    hazardous: int

    @property
    def num_frames(self) -> int:
        """All frames."""
        return self.available + self.unavailable + self.misleading + self.hazardous


def stanford_counts(error: Float[np.ndarray, " n"], level: Float[np.ndarray, " n"], limit: float) -> StanfordCounts:
    """Counts of one direction.

    Args:
        error: Errors, signed or not.
        level: Protection levels, in the same unit.
        limit: Alert limit, in the same unit.
    """
    size = np.abs(error)
    is_offered, is_bounded, is_inside = level <= limit, size <= level, size <= limit
    hazardous = is_offered & ~is_inside
    return StanfordCounts(
        available=int(np.sum(is_offered & is_bounded)),
        unavailable=int(np.sum(~is_offered & is_bounded)),
        misleading=int(np.sum(~is_bounded & ~hazardous)),
        hazardous=int(np.sum(hazardous)),
    )


def integrity_metrics(
    name: str,
    error: Float[np.ndarray, " n"],
    sigma: Float[np.ndarray, " n"],
    level: Float[np.ndarray, " n"],
    limit: float,
    offered: Bool[np.ndarray, " n"] | None = None,
) -> list[Metric]:
    """Sigma coverage and Stanford counts of one direction as metrics.

    Args:
        name: Of the direction, e.g. `lateral`.
        error: Errors.
        sigma: Stated standard deviations.
        level: Protection levels.
        limit: Alert limit.
        offered: Frames that the localizer calls tracked; None for all. The others count as unavailable: their level is
            taken as infinite.
    """
    level = level if offered is None else np.where(offered, level, np.inf)
    counts = stanford_counts(error, level, limit)
    num = max(counts.num_frames, 1)
    key = f"integrity.{name}"
    return [
        Metric(f"{key}.in_3_sigma", sigma_coverage(error, sigma), "share", "higher", 0.01),
        Metric(f"{key}.available", counts.available / num, "share", "higher", 0.02),
        Metric(f"{key}.unavailable", counts.unavailable / num, "share", "report"),
        Metric(f"{key}.misleading", counts.misleading / num, "share", "lower"),
        Metric(f"{key}.hazardous", counts.hazardous / num, "share", "lower"),
    ]
