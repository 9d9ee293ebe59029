"""Two sub-maps of classified marks met by two marks at a time (room: mapping; host).

In: marks of two sub-maps, a motion by odometry. Out: the motion in the plane that most marks agree with.
Road-SLAM (IV 2017): marks of the same class at the same distance of each other are a hypothesis; the one with most
inliers is the start of an ICP. All pairs are tried where they are few, else a seeded sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.geometry import rigid
from semloc_jax.geometry.umeyama import umeyama


class SeenMark(NamedTuple):
    """An informative mark."""

    frame: int
    """Frame that saw it first."""
    kind: int
    """`MarkKind`."""
    xy: Float[np.ndarray, " 2"]
    """Its middle [m]."""
    num_seen: int

    def moved(self, T_a_b: Float[np.ndarray, "4 4"]) -> "SeenMark":
        """The mark of frame b in frame a, in the plane."""
        return self._replace(xy=T_a_b[:2, :2] @ self.xy + T_a_b[:2, 3])


@dataclass(frozen=True)
class MarkPairsConfig:
    """When two pairs of marks lie alike. All values are ours."""

    same_m: float = 1.0
    """Sightings of one class nearer together are one mark."""
    min_seen: int = 2
    """A mark that one frame alone saw is no mark."""
    distance_m: float = 0.4
    """By which distances of pairs may differ, and marks from their partners."""
    min_apart_m: float = 2.0
    """Marks nearer together tell no heading."""
    min_inliers: int = 2
    sigmas: float = 3.0
    """Motions farther from that of the odometry are left out; Road-SLAM's."""
    least_sigma: tuple[float, float, float] = (0.5, 0.5, 0.02)
    """Of the odometry, along, across [m] and in heading [rad]."""
    max_trials: int = 4000
    seed: int = 0


def merged(marks: Sequence[SeenMark], config: MarkPairsConfig | None = None) -> list[SeenMark]:
    """Sightings of one class near to each other as one mark; those that one frame alone saw are left out."""
    config = config or MarkPairsConfig()
    found: list[SeenMark] = []
    for mark in marks:
        for k, known in enumerate(found):
            if known.kind == mark.kind and np.linalg.norm(known.xy - mark.xy) < config.same_m:
                num = known.num_seen + 1
                found[k] = known._replace(xy=known.xy + (mark.xy - known.xy) / num, num_seen=num)
                break
        else:
            found.append(mark)
    return [mark for mark in found if mark.num_seen >= config.min_seen]


def motion_by_pairs(
    source: Sequence[SeenMark],
    target: Sequence[SeenMark],
    T_target_source: Float[np.ndarray, "4 4"],
    sigma: Float[np.ndarray, " 3"],
    config: MarkPairsConfig,
) -> Float[np.ndarray, "4 4"] | None:
    """The motion in the plane that most marks agree with, near that of the odometry; None where no two lie alike.

    Args:
        source: marks to be moved.
        target: marks that stay.
        T_target_source: by odometry.
        sigma: its standard deviations along x, y [m] and in heading [rad].
        config: limits.
    """
    limit = config.sigmas * np.maximum(sigma, config.least_sigma)
    xy_s, xy_t = (np.array([mark.xy for mark in marks]) for marks in (source, target))
    same = np.array([mark.kind for mark in source])[:, None] == np.array([mark.kind for mark in target])
    best, most = None, (config.min_inliers - 1, 0.0)
    for i, j, k, m in _quadruples(xy_s, xy_t, same, config):
        fit = umeyama(xy_t[[k, m]], xy_s[[i, j]])
        T = rigid.planar_pose(*fit.t_a_b, float(np.arctan2(fit.R_a_b[1, 0], fit.R_a_b[0, 0])))
        off = rigid.log(rigid.inverse(T_target_source) @ T)[[0, 1, 5]]
        if np.any(np.abs(off) > limit):
            continue
        away_m = np.linalg.norm((xy_s @ T[:2, :2].T + T[:2, 3])[:, None] - xy_t, axis=2)
        nearest = np.where(same, away_m, np.inf).min(axis=1)
        is_in = nearest <= config.distance_m
        score = int(is_in.sum()), -float(np.sum(nearest[is_in]))
        if score > most:
            best, most = T, score
    return best


def _quadruples(
    xy_s: np.ndarray, xy_t: np.ndarray, same: np.ndarray, config: MarkPairsConfig
) -> list[tuple[int, int, int, int]]:
    """Two marks here and two there, of the same classes and as far apart."""
    apart_s, apart_t = (np.linalg.norm(xy[:, None] - xy, axis=2) for xy in (xy_s, xy_t))
    found = []
    for i, j in permutations(range(len(xy_s)), 2):
        if i > j or apart_s[i, j] < config.min_apart_m:
            continue
        alike = same[i][:, None] & same[j] & (np.abs(apart_t - apart_s[i, j]) <= config.distance_m)
        found += [(i, j, int(k), int(m)) for k, m in np.argwhere(alike) if k != m]
    if len(found) <= config.max_trials:
        return found
    chosen = np.random.default_rng(config.seed).choice(len(found), config.max_trials, replace=False)
    return [found[k] for k in np.sort(chosen)]
