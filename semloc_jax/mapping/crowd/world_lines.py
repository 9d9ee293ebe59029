"""Lines that any drive has seen, and where a drive saw them (room: mapping; host).

In: lines of drives as places a metre apart. Out: WorldLine; which stations of it a drive saw, and where.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
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
_STRAIGHT_STATIONS = 4.0
_BEYOND = 12
_ALONE = 2.0
"""That a drive shows one of two lines side by side and takes it for the other is as unlikely as so many gates."""
_NEAR = 6


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

    def placed_at(self, s_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """The same where the drive places them [m]."""
        return np.column_stack([np.interp(s_m, self.now_m, axis) for axis in self.placed.T])

    def is_near(self, s_m: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " k"]:
        """Which of its places are less than a metre along it from any of these."""
        if not len(s_m):
            return np.zeros(len(self.now_m), dtype=bool)
        return cKDTree(s_m[:, None]).query(self.now_m[:, None])[0] < STATION_M

    def feet(self, xy: Float[np.ndarray, "n 2"], reach_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Which points lie within reach of the line, and the arc length of the place of it nearest to each [m]."""
        vertex_m, vertex = self.tree.query(xy, distance_upper_bound=reach_m + STATION_M)
        rows = np.flatnonzero(np.isfinite(vertex_m))
        if not len(rows):
            return rows, np.zeros(0)
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
    """Where a drive saw lines of one kind."""

    line: Int[np.ndarray, " k"]
    """Which of the lines."""
    station: Int[np.ndarray, " k"]
    """Stations of these."""
    places: Float[np.ndarray, "k 3"]
    """What it saw there as it placed it itself [m]."""
    sigma_m: Float[np.ndarray, " k"]
    piece: Int[np.ndarray, " k"]
    """Which of its pieces shows it."""
    s_m: Float[np.ndarray, " k"]
    """Where along that."""


def line_sights(lines: Sequence[WorldLine], pieces: Sequence[Piece], gate_m: float) -> LineSights:
    """Where a drive saw lines: each place of a line on one of its pieces, of two lines side by side each on its own.

    Args:
        lines: of one kind.
        pieces: lines of that kind that the drive saw.
        gate_m: none is farther aside than this.
    """
    line = np.repeat(np.arange(len(lines)), [len(s.reference) for s in lines])
    station = np.concatenate([np.zeros(0, np.int64), *(np.arange(len(s.reference)) for s in lines)])
    xy = np.concatenate([np.zeros((0, 2)), *(s.xy for s in lines)])
    aside_m, s_m = _beside(lines, xy, pieces, gate_m)
    piece = _each_its_own(aside_m, line, xy, gate_m)
    seen = np.flatnonzero(piece >= 0)
    piece = piece[seen]
    s_m = s_m[seen, piece]
    places = np.zeros((len(seen), 3))
    for k in np.unique(piece).tolist():
        rows = piece == k
        places[rows] = pieces[k].placed_at(s_m[rows])
    sigma_m = np.array([own.sigma_m for own in pieces])[piece] if len(seen) else np.zeros(0)
    return LineSights(line[seen], station[seen], places, sigma_m, piece, s_m)


def _beside(
    lines: Sequence[WorldLine], xy: np.ndarray, pieces: Sequence[Piece], gate_m: float
) -> tuple[Float[np.ndarray, "n p"], Float[np.ndarray, "n p"]]:
    """How far aside of each station each piece runs, infinite where it does not; and at which arc length [m]."""
    left = np.concatenate([np.zeros((0, 2)), *(s.left for s in lines)])
    aside_m, along_m = np.full((len(xy), len(pieces)), np.inf), np.zeros((len(xy), len(pieces)))
    for column, piece in enumerate(pieces):
        k, s_m = piece.feet(xy, float(np.hypot(gate_m, _BESIDE_M)))
        if not len(k):
            continue
        near, ahead, behind = (piece.at(s_m + d) for d in (0.0, _TANGENT_M, -_TANGENT_M))
        offset = near - xy[k]
        aside = (offset * left[k]).sum(axis=1)
        beside = np.linalg.norm(offset - aside[:, None] * left[k], axis=1)
        step = (ahead - behind) / np.maximum(np.linalg.norm(ahead - behind, axis=1, keepdims=True), 1e-9)
        parallel = np.abs((step * left[k]).sum(axis=1)) < np.sin(SAME_TURN_RAD)
        shown = (np.abs(aside) < gate_m) & (beside < _BESIDE_M) & parallel
        aside_m[k[shown], column], along_m[k[shown], column] = np.abs(aside[shown]), s_m[shown]
    return aside_m, along_m


def _each_its_own(
    aside_m: Float[np.ndarray, "n p"], line: Int[np.ndarray, " n"], xy: Float[np.ndarray, "n 2"], gate_m: float
) -> Int[np.ndarray, " n"]:
    """Which piece each station is seen on, -1 for none.

    The nearest one. But of two lines side by side, as those of a double line, no two are seen on one piece: the second
    then is seen on another one, or not at all, whichever explains both better.
    """
    if not aside_m.shape[1]:
        return np.full(len(line), -1)
    num = np.arange(len(line))
    squared = np.where(np.isfinite(aside_m), aside_m**2, np.inf)
    first = squared.argmin(axis=1)
    rest = squared.copy()
    rest[num, first] = np.inf
    second = rest.argmin(axis=1)
    best, spare = squared[num, first], np.minimum(rest[num, second], (_ALONE * gate_m) ** 2)
    chosen = np.where(np.isfinite(best), first, -1)
    other = np.where(np.isfinite(rest[num, second]), second, -1)
    a, b = _side_by_side(line, xy, 2.0 * gate_m).T
    both = (chosen[a] == chosen[b]) & (chosen[a] >= 0)
    a, b = a[both], b[both]
    gives_way = np.where(spare[a] + best[b] < best[a] + spare[b], a, b)
    chosen[gives_way] = other[gives_way]
    return chosen


def _side_by_side(line: Int[np.ndarray, " n"], xy: Float[np.ndarray, "n 2"], reach_m: float) -> Int[np.ndarray, "k 2"]:
    """Each station and the nearest one of another line beside it."""
    if len(xy) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    apart_m, near = cKDTree(xy).query(xy, k=min(_NEAR, len(xy)), distance_upper_bound=np.hypot(reach_m, STATION_M))
    is_other = np.isfinite(apart_m) & (line[np.minimum(near, len(xy) - 1)] != line[:, None])
    rows = np.flatnonzero(is_other.any(axis=1))
    return np.stack([rows, near[rows, is_other[rows].argmax(axis=1)]], axis=1)


def all_of(lines: Sequence[WorldLine]) -> shapely.Geometry:
    """Lines as one geometry."""
    places = np.concatenate([np.zeros((0, 2)), *(line.xy for line in lines)])
    row = np.repeat(np.arange(len(lines)), [len(line.reference) for line in lines])
    return shapely.multilinestrings(shapely.linestrings(places, indices=row)) if lines else shapely.MultiLineString()


def distance_m(lines: shapely.Geometry, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """From each point to the nearest of all lines [m]; infinite without lines."""
    return np.full(len(xy), np.inf) if lines.is_empty else shapely.distance(shapely.points(xy), lines)
