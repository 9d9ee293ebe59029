"""Lines that any drive has seen, and where a drive saw them (room: mapping; host).

In: lines of drives as places a metre apart. Out: WorldLine; which stations of it a drive saw, and where.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from semloc_jax.geometry import polyline
from semloc_jax.mapping.crowd.stations import STATION_M
from semloc_jax.maps import MapElement

SAME_TURN_RAD = 0.35
"""What is turned by more is another line, or another thing."""
_BESIDE_M = 0.3
_TANGENT_M = 0.25
_NEARER_M = 0.05
"""A place is that of the nearer of two lines where it is nearer by so much; ours."""
_STRAIGHT_STATIONS = 4.0
_BEYOND = 12


@dataclass
class WorldLine:
    """A line: places on a reference, and how far to its left the line runs there.

    Attributes:
        kind: as `map_shapes` names it.
        source: place of the drive among all, and the element that it was born of.
        reference: `float64[k 2]` [m].
        rough: `float64[k 2]` how far the reference is off a smooth line [m].
        left: unit `float64[k 2]`.
        offset_m: `float64[k]`.
    """

    kind: str
    source: tuple[int, MapElement]
    reference: Float[np.ndarray, "k 2"]
    rough: Float[np.ndarray, "k 2"]
    left: Float[np.ndarray, "k 2"]
    offset_m: Float[np.ndarray, " k"]

    @classmethod
    def along(cls, kind: str, source: tuple[int, MapElement], xy: Float[np.ndarray, "k 2"]) -> "WorldLine":
        """A line through places a metre apart."""
        # Their left is that of the road, not of every wobble: what is smooth must stay so when all of it moves.
        step = gaussian_filter1d(np.gradient(xy, axis=0), _STRAIGHT_STATIONS, axis=0, mode="nearest")
        step /= np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
        ahead, behind = 2.0 * xy[:1] - xy[_BEYOND:0:-1], 2.0 * xy[-1:] - xy[-2 : -2 - _BEYOND : -1]
        longer = gaussian_filter1d(np.vstack([ahead, xy, behind]), _STRAIGHT_STATIONS, axis=0, mode="nearest")
        smooth = longer[len(ahead) : len(ahead) + len(xy)]
        return cls(kind, source, xy, xy - smooth, np.stack([-step[:, 1], step[:, 0]], axis=1), np.zeros(len(xy)))

    @property
    def xy(self) -> Float[np.ndarray, "k 2"]:
        """Where the line runs [m]."""
        return self.reference + self.offset_m[:, None] * self.left


@dataclass(frozen=True)
class Piece:
    """A line that a drive saw.

    Attributes:
        placed: `float64[k 3]` places about a metre apart where the drive places it [m].
        now: `float64[k 2]` the same places where they are in the map by now.
        now_m: `float64[k]` arc length of each along `now`.
        sigma_m: of the line, across.
        tree: of `now`.
    """

    placed: Float[np.ndarray, "k 3"]
    now: Float[np.ndarray, "k 2"]
    now_m: Float[np.ndarray, " k"]
    sigma_m: float
    tree: cKDTree

    @classmethod
    def of(cls, placed: np.ndarray, now: np.ndarray, sigma_m: float) -> "Piece":
        """The piece through these places."""
        return cls(placed, now, polyline.arc_length(now), sigma_m, cKDTree(now))

    def at(self, s_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Places of the line by arc length, before its start and past its end those of the ends [m]."""
        return np.column_stack([np.interp(s_m, self.now_m, axis) for axis in self.now.T])

    def feet(self, xy: Float[np.ndarray, "n 2"], reach_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Which points lie within reach of the line, and the arc length of the place of it nearest to each [m]."""
        vertex_m, vertex = self.tree.query(xy, distance_upper_bound=reach_m + STATION_M)
        rows = np.flatnonzero(np.isfinite(vertex_m))
        best_m, s_m = np.full(len(rows), np.inf), np.zeros(len(rows))
        for first in (vertex[rows] - 1, vertex[rows]):
            k = np.clip(first, 0, len(self.now) - 2)
            step, length_m = self.now[k + 1] - self.now[k], self.now_m[k + 1] - self.now_m[k]
            offset = xy[rows] - self.now[k]
            share = np.clip((offset * step).sum(axis=1) / np.maximum(length_m, 1e-9) ** 2, 0.0, 1.0)
            apart_m = np.linalg.norm(offset - share[:, None] * step, axis=1)
            s_m = np.where(apart_m < best_m, self.now_m[k] + share * length_m, s_m)
            best_m = np.minimum(best_m, apart_m)
        near = best_m <= reach_m
        return rows[near], s_m[near]


class LineSights(NamedTuple):
    """Where a drive saw a line."""

    station: Int[np.ndarray, " k"]
    """Stations of the line."""
    places: Float[np.ndarray, "k 3"]
    """What it saw there as it placed it itself [m]."""
    sigma_m: Float[np.ndarray, " k"]
    now: Float[np.ndarray, "k 2"]
    """The same places where they are in the map by now [m]."""
    aside_m: Float[np.ndarray, " k"]
    """How far they are off the line."""
    piece: Int[np.ndarray, " k"]
    """Of which of the pieces they are."""

    def of(self, rows: Bool[np.ndarray, " k"]) -> "LineSights":
        """Some of them."""
        return LineSights(*(column[rows] for column in self))


def line_sights(line: WorldLine, pieces: Sequence[Piece], gate_m: float) -> LineSights:
    """Where a drive saw a line.

    Args:
        line: the line.
        pieces: lines of its kind that the drive saw.
        gate_m: none is farther aside than this.
    """
    xy = line.xy
    best = np.full(len(xy), gate_m)
    places, sigma, now = np.zeros((len(xy), 3)), np.zeros(len(xy)), np.zeros((len(xy), 2))
    which = np.zeros(len(xy), dtype=np.int64)
    for row, piece in enumerate(pieces):
        k, s_m = piece.feet(xy, float(np.hypot(gate_m, _BESIDE_M)))
        if not len(k):
            continue
        near, ahead, behind = (piece.at(s_m + d) for d in (0.0, _TANGENT_M, -_TANGENT_M))
        offset, left = near - xy[k], line.left[k]
        aside = (offset * left).sum(axis=1)
        beside = np.linalg.norm(offset - aside[:, None] * left, axis=1)
        step = (ahead - behind) / np.maximum(np.linalg.norm(ahead - behind, axis=1, keepdims=True), 1e-9)
        parallel = np.abs((step * left).sum(axis=1)) < np.sin(SAME_TURN_RAD)
        better = (np.abs(aside) < best[k]) & (beside < _BESIDE_M) & parallel
        k, s_m = k[better], s_m[better]
        best[k], sigma[k], now[k], which[k] = np.abs(aside[better]), piece.sigma_m, near[better], row
        places[k] = np.column_stack([np.interp(s_m, piece.now_m, axis) for axis in piece.placed.T])
    return LineSights(np.arange(len(xy)), places, sigma, now, best, which).of(best < gate_m)


def of_nearest(sights: Sequence[LineSights]) -> list[LineSights]:
    """What a drive saw of lines of one kind, each place only as that of the line that it is nearest to."""
    line = np.repeat(np.arange(len(sights)), [len(each.station) for each in sights])
    if len(sights) < 2 or not len(line):
        return list(sights)
    now, aside_m = np.concatenate([s.now for s in sights]), np.concatenate([s.aside_m for s in sights])
    a, b = cKDTree(now).query_pairs(STATION_M, output_type="ndarray").T
    piece = np.concatenate([s.piece for s in sights])
    other = (line[a] != line[b]) & (piece[a] == piece[b])
    a, b = a[other], b[other]
    farther = np.where(aside_m[a] > aside_m[b], a, b)
    kept = np.ones(len(line), dtype=bool)
    kept[farther[np.abs(aside_m[a] - aside_m[b]) > _NEARER_M]] = False
    return [each.of(kept[line == k]) for k, each in enumerate(sights)]
