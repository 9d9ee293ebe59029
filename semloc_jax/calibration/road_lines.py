"""Which painted lines of different images are the same line of the road (room: calibration; host).

In: Streaks, mounts and poses as known so far. Out: RoadLines: streaks of at least two images that lie on each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from semloc_jax.calibration.road_streaks import Streak
from semloc_jax.residuals.road_sight import LEAST_DIP

_TURN_DEG_PER_M = 20.0
"""How far streaks of one line may be turned against each other, for each metre that they may lie apart."""
_OVERLAP_M = 0.4


class RoadLine(NamedTuple):
    """One line of the road.

    Attributes:
        streaks: indices of those that show it.
        along: a point of it and its unit direction in odom, float64[2 2].
    """

    streaks: Int[np.ndarray, " s"]
    along: Float[np.ndarray, "2 2"]


@dataclass(frozen=True)
class LaidStreak:
    """A streak on the road, in odom [m].

    Attributes:
        xy: its places.
        ends: both ends; NaN where not seen.
        sights: from the camera to each place, level.
        end_sights: the same for both ends.
        middle: mean of the places.
        direction: unit direction.
        reach: first and last place along it.
    """

    xy: Float[np.ndarray, "n 2"]
    ends: Float[np.ndarray, "2 2"]
    sights: Float[np.ndarray, "n 2"]
    end_sights: Float[np.ndarray, "2 2"]
    middle: Float[np.ndarray, " 2"]
    direction: Float[np.ndarray, " 2"]
    reach: Float[np.ndarray, " 2"]


def laid(streak: Streak, T_odom_cam: Float[np.ndarray, "4 4"]) -> LaidStreak:
    """A streak where its lines of sight meet the road."""
    xy, ends = (_on_road(rays, T_odom_cam) for rays in (streak.rays_cam, streak.end_rays_cam))
    middle = xy.mean(axis=0)
    direction = np.linalg.svd(xy - middle, full_matrices=False)[2][0]
    reach = (xy - middle) @ direction
    camera = T_odom_cam[:2, 3]
    span = np.array([reach.min(), reach.max()])
    return LaidStreak(xy, ends, xy - camera, ends - camera, middle, direction, span)


def match_lines(streaks: Sequence[Streak], on_road: Sequence[LaidStreak], gate_m: float) -> list[RoadLine]:
    """Lines that at least two images show.

    Two streaks are of one line where each is the nearest of its class to the other among those of its image, in the
    gate and side by side.

    Args:
        streaks: all of them.
        on_road: the same on the road.
        gate_m: how far apart they may lie.
    """
    image = np.array([1000 * streak.frame + streak.camera for streak in streaks])
    label = np.array([streak.label for streak in streaks])
    away_m = _distances(on_road, gate_m)
    away_m[(image[:, None] == image) | (label[:, None] != label)] = np.inf
    nearest = np.zeros(away_m.shape, bool)
    for one in np.unique(image):
        columns = np.flatnonzero(image == one)
        best = columns[away_m[:, columns].argmin(axis=1)]
        nearest[np.arange(len(best)), best] = True
    linked = nearest & nearest.T & np.isfinite(away_m)
    _, number = connected_components(coo_matrix(linked), directed=False)
    lines = []
    for group in np.unique(number):
        members = np.flatnonzero(number == group)
        if len(np.unique(image[members])) > 1:
            lines.append(RoadLine(members, _fitted([on_road[k] for k in members])))
    return lines


def _on_road(rays_cam: np.ndarray, T_odom_cam: np.ndarray) -> Float[np.ndarray, "n 2"]:
    ray = rays_cam @ T_odom_cam[:3, :3].T
    return T_odom_cam[:2, 3] + (T_odom_cam[2, 3] / np.maximum(-ray[:, 2:], LEAST_DIP)) * ray[:, :2]


def _distances(on_road: Sequence[LaidStreak], gate_m: float) -> Float[np.ndarray, "s s"]:
    """How far two streaks lie apart across, at the worse end of what both show; inf beyond the gate."""
    middle, direction, reach = (
        np.stack([getattr(streak, part) for streak in on_road]) for part in ("middle", "direction", "reach")
    )
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    cosine, sine = direction @ direction.T, normal @ direction.T
    sign = np.where(cosine < 0, -1.0, 1.0)
    step = middle - middle[:, None]
    ahead, left = (np.einsum("ijk,ik->ij", step, axis) for axis in (direction, normal))
    # The other streak along this one.
    low = ahead + np.where(sign > 0, reach[:, 0], -reach[:, 1])
    high = ahead + np.where(sign > 0, reach[:, 1], -reach[:, 0])
    first, last = np.maximum(low, reach[:, :1]), np.minimum(high, reach[:, 1:])
    slope = sine / np.where(np.abs(cosine) < 0.5, 0.5, cosine)
    off = np.maximum(np.abs(left + slope * (first - ahead)), np.abs(left + slope * (last - ahead)))
    turned = np.abs(sine) > np.sin(np.deg2rad(_TURN_DEG_PER_M * max(gate_m, 0.1)))
    apart = (last - first < _OVERLAP_M) | turned | (np.abs(cosine) < 0.5) | (off > gate_m)
    return np.where(apart, np.inf, off)


def _fitted(members: Sequence[LaidStreak]) -> Float[np.ndarray, "2 2"]:
    """A point and the direction of the line through all places."""
    xy = np.concatenate([member.xy for member in members])
    middle = xy.mean(axis=0)
    return np.stack([middle, np.linalg.svd(xy - middle, full_matrices=False)[2][0]])
