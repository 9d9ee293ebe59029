"""Where a drive may have come back to a place (room: mapping; host).

In: ChainSolution, way driven. Out: Revisit list: an earlier pass, a group of later frames, how far the way may be off.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from semloc_jax.mapping.chain_graph import ChainSolution


@dataclass(frozen=True)
class RevisitConfig:
    """Which places are looked at again. All values are ours."""

    every_m: float = 20.0
    """Way between the groups of frames that are looked at."""
    num_frames: int = 4
    """Frames of a group."""
    span_m: float = 12.0
    """Way that a group spans."""
    min_way_m: float = 60.0
    """A place passed less than this ago is no revisit."""
    reach_m: float = 10.0
    """Two poses this far apart still see the same things."""
    probability: float = 0.99
    """Passes within this share of the distribution of the distance are candidates."""
    max_sigma_m: float = 30.0
    """Where the way is known less than this, nothing is searched."""
    max_turn_deg: float = 180.0
    """Passes whose heading differs more are left out; 180 keeps the opposite direction."""


class Revisit(NamedTuple):
    """An earlier pass and a group of later frames that may show the same place."""

    a: int
    """The nearest frame of the earlier pass."""
    b: int
    """The middle frame of the group."""
    frames: tuple[int, ...]
    covariance: Float[np.ndarray, "6 6"]
    """Of the right tangent of T_a_b by the way."""
    is_second_look: bool = False
    """Whether the loops of other places have told how the way goes."""

    @property
    def sigma_xy_m(self) -> float:
        """Largest horizontal standard deviation of T_a_b."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))

    @property
    def sigma_heading_rad(self) -> float:
        """Standard deviation of the heading of T_a_b."""
        return float(np.sqrt(self.covariance[5, 5]))


def groups(way_m: Float[np.ndarray, " n"], config: RevisitConfig) -> list[tuple[int, ...]]:
    """Frames of each group, spread evenly over the way that it spans; a vehicle that stands gives no group."""
    found = []
    for middle_m in np.arange(way_m[0] + 0.5 * config.span_m, way_m[-1] - 0.5 * config.span_m, config.every_m):
        at_m = middle_m + config.span_m * np.linspace(-0.5, 0.5, config.num_frames)
        frames = np.unique(np.searchsorted(way_m, at_m).clip(0, len(way_m) - 1))
        if len(frames) == config.num_frames:
            found.append(tuple(frames.tolist()))
    return found


def revisits(
    solution: ChainSolution, way_m: Float[np.ndarray, " n"], frames: tuple[int, ...], config: RevisitConfig
) -> list[Revisit]:
    """Earlier passes of the place of a group, nearest first.

    Args:
        solution: The way as it is known.
        way_m: Way driven up to each frame.
        frames: The group.
        config: Limits.
    """
    b = frames[len(frames) // 2]
    passes = _passes(solution.Ts_map_base, way_m, b, config)
    if not passes:
        return []
    covariances = solution.relative_covariance(passes, [b] * len(passes))
    gate = float(chdtri(2, 1.0 - config.probability))
    found = []
    for a, covariance in zip(passes, covariances, strict=True):
        revisit = Revisit(a, b, frames, covariance)
        away_m = np.linalg.norm((solution.Ts_map_base[a] - solution.Ts_map_base[b])[:2, 3])
        beyond_m = max(float(away_m) - config.reach_m, 0.0)
        if beyond_m**2 <= gate * revisit.sigma_xy_m**2 and revisit.sigma_xy_m <= config.max_sigma_m:
            found.append((float(away_m), revisit))
    return [revisit for _, revisit in sorted(found, key=lambda pair: pair[0])]


def _passes(Ts: np.ndarray, way_m: np.ndarray, b: int, config: RevisitConfig) -> list[int]:
    """The nearest frame of every earlier pass within the widest gate."""
    farthest_m = config.reach_m + 3.1 * config.max_sigma_m
    away_m = np.linalg.norm(Ts[:, :2, 3] - Ts[b, :2, 3], axis=1)
    turn = np.arctan2(Ts[:, 1, 0], Ts[:, 0, 0]) - np.arctan2(Ts[b, 1, 0], Ts[b, 0, 0])
    turn_deg = np.degrees(np.abs(np.mod(turn + np.pi, 2 * np.pi) - np.pi))
    earlier = (way_m < way_m[b] - config.min_way_m) & (away_m < farthest_m) & (turn_deg <= config.max_turn_deg)
    near = np.flatnonzero(earlier)
    passes: list[int] = []
    # From the nearest on: what lies within min_way_m of a pass that is taken belongs to it.
    for a in near[np.argsort(away_m[near], kind="stable")].tolist():
        if all(abs(way_m[a] - way_m[taken]) > 0.5 * config.min_way_m for taken in passes):
            passes.append(a)
    return passes
