"""The posterior over places from nats that are too sure of themselves (room: alignment; host).

In: candidate poses, their evidence by part of the image, a prior. Out: Ridges, the places with their probabilities.
Pieces of a map share errors, so that the sum of their nats differs between poses more than it should. How far the
difference of two poses can be believed is seen in its own scatter over the image (Vuong's test as a temperature).
"""

from dataclasses import dataclass

import numpy as np

PRIOR_FREEDOM = 3.0
"""Degrees of freedom of the prior's Student t: a sigma that is stated too small does not decide alone."""


@dataclass(frozen=True)
class PosteriorConfig:
    """What is one place, and how evidence is tempered. All values are ours."""

    along_m: float = 3.2
    across_m: float = 0.6
    heading_deg: float = 2.0
    """Poses nearer than this along, across and in heading are one ridge."""
    lever_m: float = 25.0
    """Across is measured where the vehicle stands or so far ahead: a turn about what is in view is the same place."""
    least_temper: float = 0.1
    most_temper: float = 1.0


@dataclass(frozen=True)
class Ridges:
    """Places, best first.

    Attributes:
        best: row of the best candidate of each place, int[m].
        probability: of each place, float[m].
        home: place of every candidate, int[n]; -1 where the candidate is none.
        log_weight: tempered log weight of every candidate against the best one, float[n].
    """

    best: np.ndarray
    probability: np.ndarray
    home: np.ndarray
    log_weight: np.ndarray

    @property
    def margin_nats(self) -> float:
        """By how much the best place is more probable than the next one; infinite where there is no other [nats]."""
        return float(np.subtract(*self.log_weight[self.best[:2]])) if len(self.best) > 1 else np.inf


def log_prior(Ts: np.ndarray, T_prior: np.ndarray, sigma_xy_m: float, sigma_heading_rad: float) -> np.ndarray:
    """Log density of Student's t around the prior, up to a constant, float[n]."""
    away, turn = differences(T_prior, Ts)
    squared = (away**2).sum(axis=1) / sigma_xy_m**2 + (turn / sigma_heading_rad) ** 2
    return -0.5 * (PRIOR_FREEDOM + 3.0) * np.log1p(squared / PRIOR_FREEDOM)


def temper(block_nats: np.ndarray, best: int, config: PosteriorConfig) -> np.ndarray:
    """How far the evidence of the best candidate over each other one may be believed, float[n] in (0, 1]."""
    difference = block_nats[best] - block_nats
    used = (np.abs(block_nats[best]) > 0) | (np.abs(block_nats) > 0)
    num = np.maximum(used.sum(axis=1), 2)
    total = difference.sum(axis=1)
    mean = total / num
    variance = (np.where(used, difference - mean[:, None], 0.0) ** 2).sum(axis=1) / (num - 1)
    return np.clip(2.0 * np.abs(total) / np.maximum(num * variance, 1e-9), config.least_temper, config.most_temper)


def ridges(Ts: np.ndarray, block_nats: np.ndarray, prior: np.ndarray, config: PosteriorConfig) -> Ridges:
    """The places among the candidates and their probabilities.

    Args:
        Ts: float[n 4 4], candidate poses.
        block_nats: float[n block], evidence by part of the image; NaN rows are no candidates.
        prior: float[n], log prior of each.
        config: Size of a place, temperature.
    """
    nats = block_nats.sum(axis=1)
    valid = np.isfinite(nats) & np.isfinite(Ts).all(axis=(1, 2))
    if not valid.any():
        empty = np.zeros(0, int)
        return Ridges(empty, np.zeros(0), np.full(len(Ts), -1), np.full(len(Ts), -np.inf))
    best = int(np.argmax(np.where(valid, nats + prior, -np.inf)))
    log_weight = _against(best, nats, block_nats, prior, valid, config)
    # Tempered evidence leaves more to the prior: the best may be another one.
    for _ in range(3):
        if np.argmax(log_weight) == best:
            break
        best = int(np.argmax(log_weight))
        log_weight = _against(best, nats, block_nats, prior, valid, config)
    home, leaders = np.full(len(Ts), -1), []
    for index in np.argsort(-log_weight, kind="stable"):
        if not valid[index] or home[index] >= 0:
            continue
        home[valid & (home < 0) & same_ridge(Ts[index], Ts, config)] = len(leaders)
        leaders.append(int(index))
    leaders = np.asarray(leaders)
    weight = np.exp(log_weight[leaders] - log_weight[leaders].max())
    return Ridges(leaders, weight / weight.sum(), home, log_weight)


def _against(
    best: int, nats: np.ndarray, block_nats: np.ndarray, prior: np.ndarray, valid: np.ndarray, config: PosteriorConfig
) -> np.ndarray:
    tempered = temper(np.where(valid[:, None], block_nats, 0.0), best, config)
    weight = -tempered * (nats[best] - nats) + prior - prior[best]
    return np.where(valid, weight, -np.inf)


def differences(T_from: np.ndarray, Ts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(forward, left) [m] in the frame of `T_from` and turn [rad] of each pose."""
    away = (Ts[:, :3, 3] - T_from[:3, 3]) @ T_from[:3, :2]
    turn = np.arctan2(Ts[:, 1, 0], Ts[:, 0, 0]) - np.arctan2(T_from[1, 0], T_from[0, 0])
    return away, np.mod(turn + np.pi, 2.0 * np.pi) - np.pi


def same_ridge(T: np.ndarray, Ts: np.ndarray, config: PosteriorConfig) -> np.ndarray:
    """Which poses are one place with another, bool[n]."""
    away, turn = differences(T, Ts)
    here_m, ahead_m = np.abs(away[:, 1]), np.abs(away[:, 1] + config.lever_m * turn)
    near = (here_m < config.across_m) | ((ahead_m < config.across_m) & (here_m < 2.0 * config.across_m))
    return near & (np.abs(away[:, 0]) < config.along_m) & (np.abs(np.degrees(turn)) < config.heading_deg)


def spread(T_centre: np.ndarray, Ts: np.ndarray, log_weight: np.ndarray) -> np.ndarray:
    """Second moment of weighted poses about one of them, float[3 3] (forward, left [m], heading [rad])."""
    away, turn = differences(T_centre, Ts)
    share = np.exp(log_weight - log_weight.max())
    steps = np.column_stack([away, turn])
    return (steps * (share / share.sum())[:, None]).T @ steps
