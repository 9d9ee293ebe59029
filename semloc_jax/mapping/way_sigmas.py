"""How far a map may be off as a whole around each place, from what is known of the way (room: mapping; host).

In: the joint covariance of some poses of the way that a map was drawn along. Out: WaySigmas, a BeliefMap that states
them. All that is seen from one stretch of the way shares what its poses are off by: a drive in the map cannot notice
it, and no number of looks at an element takes it out.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from semloc_jax.maps import BeliefMap

_EVERY_M = 5.0
_MOST = 150
"""Their joint covariance is dense: this bounds its time and memory, and nothing of it changes within metres."""
_PLANE = np.array([0, 1, 5])
_AROUND_M = 7.0
"""How far from a place, in the mean square, what is seen from it lies: half of the 14 m that frames are compared in."""
_LOOKED_M = (3.0, 14.0)
"""What lies in this reach of a place is laid by it, the nearer the more; ours."""
_DIRECTIONS = 16


class WaySigmas(NamedTuple):
    """Standard deviations of the map around places of the way, after one motion in the plane for all of it."""

    xy_map: Float[np.ndarray, "k 2"]
    place_m: Float[np.ndarray, " k"]
    """Of the place of all that is seen from there, in either direction."""
    turn_rad: Float[np.ndarray, " k"]
    """Of its direction."""

    def stated(self, made: BeliefMap) -> BeliefMap:
        """The map with the sigmas of the nearest place of the way in the belief of every element."""
        if not len(self.xy_map) or not made.map.elements:
            return made
        elements = made.map.elements
        place_m, turn_rad = self.around(np.array([element.points[:, :2].mean(axis=0) for element in elements]))
        beliefs = {
            element.id: replace(made.beliefs[element.id], sigma_place_m=float(a), sigma_turn_rad=float(b))
            for element, a, b in zip(elements, place_m, turn_rad, strict=True)
        }
        return replace(made, beliefs=beliefs)

    def around(self, xy_map: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Sigmas of place [m] and direction [rad] at the places of the way nearest to points; 0 without any."""
        if not len(self.xy_map):
            return np.zeros(len(xy_map)), np.zeros(len(xy_map))
        near = cKDTree(self.xy_map).query(xy_map)[1]
        return self.place_m[near], self.turn_rad[near]


def places_apart(way_m: Float[np.ndarray, " n"], looking: Sequence[int]) -> Int[np.ndarray, " k"]:
    """Those of the frames that look at which the sigmas of a way are told."""
    rows = np.asarray(looking)
    every_m = max(_EVERY_M, float(np.ptp(way_m[rows])) / _MOST)
    return rows[np.unique(np.floor(way_m[rows] / every_m), return_index=True)[1]]


def way_sigmas(Ts_map_base: Float[np.ndarray, "k 4 4"], covariance: Float[np.ndarray, "m m"]) -> WaySigmas:
    """The sigmas of a way.

    Which frame its map lies in is no error of the map: the motion in the plane that fits it best is taken out.

    Args:
        Ts_map_base: some poses of the way.
        covariance: joint one of their right tangents, six rows each [m, rad].
    """
    num = len(Ts_map_base)
    # Of x, y in the axes of the map and the heading, of every pose.
    axes = np.zeros((num, 3, 6))
    axes[:, :2, :3] = Ts_map_base[:, :2, :3]
    axes[:, 2, _PLANE[2]] = 1.0
    joint = np.einsum("iab,ibjd,jcd->iajc", axes, covariance.reshape(num, 6, num, 6), axes).reshape(3 * num, 3 * num)
    laid = _laid(Ts_map_base[:, :2, 3])
    return planar_sigmas(Ts_map_base[:, :2, 3], laid @ joint @ laid.T)


def _laid(xy_map: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "m m"]:
    """How errors of places of a way, three rows each as for `planar_sigmas`, become errors of the map around them.

    An element is laid by all poses that look at it. Where one heading is off, the others hold the element; where all
    are off alike, it is turned about each of them, and what is ahead of one is behind another: of a turn of all
    headings against the way half is left.
    """
    num = len(xy_map)
    angle = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    arm = _AROUND_M * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # From place j to element m around place i.
    ray = xy_map[:, None, None] + arm[None, :, None] - xy_map[None, None]
    range_m = np.linalg.norm(ray, axis=-1)
    weight = np.where(range_m <= _LOOKED_M[1], np.maximum(range_m, _LOOKED_M[0]) ** -2.0, 0.0)
    weight /= weight.sum(axis=2, keepdims=True)
    # The motion of an element by x, y and heading of each place, then the motion in the plane that fits all of them.
    by_turn = np.stack([-ray[..., 1], ray[..., 0]], axis=-1)
    across = np.stack([-arm[:, 1], arm[:, 0]], axis=1) / _AROUND_M**2
    found = np.zeros((num, 3, num, 3))
    for k in range(2):
        found[:, k, :, k] = weight.mean(axis=1)
        found[:, 2, :, k] = np.einsum("m,imj->ij", across[:, k], weight) / _DIRECTIONS
        found[:, k, :, 2] = (weight * by_turn[..., k]).mean(axis=1)
    found[:, 2, :, 2] = np.einsum("mk,imj,imjk->ij", across, weight, by_turn) / _DIRECTIONS
    return found.reshape(3 * num, 3 * num)


def with_size(
    Ts_map_base: Float[np.ndarray, "k 4 4"],
    covariance: Float[np.ndarray, "m m"],
    of_sensors: Float[np.ndarray, "m m"],
    share: float,
) -> Float[np.ndarray, "m m"]:
    """A joint covariance whose size is known no better than to a share of what the sensors of the vehicle alone know.

    Args:
        Ts_map_base: some poses of the way.
        covariance: joint one of their right tangents, six rows each [m, rad].
        of_sensors: the same without what images say.
        share: of the sigma of size by the sensors, which is left.
    """
    away = Ts_map_base[:, :3, 3] - Ts_map_base[:, :3, 3].mean(axis=0)
    grown = np.zeros((len(away), 6))
    grown[:, :3] = np.einsum("iba,ib->ia", Ts_map_base[:, :3, :3], away)
    grown = grown.ravel()
    told = grown / max(grown @ grown, 1e-12)
    variance = share**2 * (told @ of_sensors @ told) - told @ covariance @ told
    return covariance + max(variance, 0.0) * np.outer(grown, grown)


def planar_sigmas(xy_map: Float[np.ndarray, "k 2"], covariance: Float[np.ndarray, "m m"]) -> WaySigmas:
    """The sigmas at places, with the motion in the plane that fits best what is seen from all of them taken out.

    The frame of a map is that of its elements, which lie around the places: where the way is as short as they are far,
    its places alone would make an error of the map of what is a turn of all of it.

    Args:
        xy_map: places.
        covariance: joint one of x, y [m] and direction [rad] of the map around each place, three rows each.
    """
    num = len(xy_map)
    common = np.tile(np.eye(3), (num, 1, 1))
    common[:, 0, 2], common[:, 1, 2] = -(xy_map - xy_map.mean(axis=0)).T[1], (xy_map - xy_map.mean(axis=0)).T[0]
    common = common.reshape(3 * num, 3)
    weight = np.tile([1.0, 1.0, _AROUND_M], num)
    rest = np.eye(3 * num) - common @ np.linalg.pinv(weight[:, None] * common) * weight
    variance = np.maximum(np.diagonal(rest @ covariance @ rest.T), 0.0).reshape(num, 3)
    return WaySigmas(xy_map, np.sqrt(variance[:, :2].mean(axis=1)), np.sqrt(variance[:, 2]))
