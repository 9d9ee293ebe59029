"""Everything that any drive has seen, each thing once (room: mapping; host).

In: Sights with their corrections. Out: CrowdWorld: things, lines as stations a metre apart; which sight is which.
A sight goes with a thing of its kind, one to one, nearest together; what is not near any is new.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from semloc_jax.evaluation.map_shapes import POSTS, kind_of
from semloc_jax.geometry import polyline
from semloc_jax.mapping.crowd.correction import Correction
from semloc_jax.mapping.crowd.sights import Things
from semloc_jax.maps import MapElement

STATION_M = 1.0
LEAST_LINE_M = 3.0
_SAME_HALF_M = 0.6
_SAME_TURN_RAD = 0.35
_LONG_HALF_M = 0.5
_BESIDE_M = 0.3
_STRAIGHT_STATIONS = 4.0
_BEYOND = 12
_POSTS = {label.name.lower() for label in POSTS}


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


@dataclass
class CrowdWorld:
    """All things and lines.

    Attributes:
        kind: of each thing.
        source: place of the drive among all, and of the thing among its things, that it was born of.
        centre: `float64[n 2]` [m].
        along: unit `float64[n 2]`.
        half_m: `float64[n 2]`.
        lines: all lines.
    """

    kind: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=object))
    source: Int[np.ndarray, "n 2"] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    centre: Float[np.ndarray, "n 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    along: Float[np.ndarray, "n 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    half_m: Float[np.ndarray, "n 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    lines: list[WorldLine] = field(default_factory=list)

    def paired(self, things: Things, centre: np.ndarray, along: np.ndarray, gate_m: float) -> Int[np.ndarray, "k 2"]:
        """Which sight is which thing: rows of the sights and of the world.

        Args:
            things: the sights.
            centre: `[n 2]` where they are in the map by now [m].
            along: `[n 2]` their direction there.
            gate_m: none is farther away than this; across its longest side half as far.
        """
        pairs = []
        for kind in sorted(set(things.kind.tolist()) & set(self.kind.tolist())):
            rows, columns = np.flatnonzero(things.kind == kind), np.flatnonzero(self.kind == kind)
            cost = self._apart(things, rows, columns, centre, along, kind in _POSTS) / gate_m**2
            chosen = linear_sum_assignment(np.minimum(cost, 1.0))
            near = cost[chosen] < 1.0
            pairs.append(np.stack([rows[chosen[0][near]], columns[chosen[1][near]]], axis=1))
        return np.concatenate([np.zeros((0, 2), dtype=np.int64), *pairs])

    def _apart(
        self, things: Things, rows: np.ndarray, columns: np.ndarray, centre: np.ndarray, along: np.ndarray, post: bool
    ) -> np.ndarray:
        """Squared distance [m^2], across counted twice; infinite between things of other size or direction."""
        offset = centre[rows][:, None] - self.centre[columns][None]
        if post:
            return (offset**2).sum(axis=2)
        ahead = self.along[columns]
        a = np.einsum("ijk,jk->ij", offset, ahead)
        c = np.einsum("ijk,jk->ij", offset, np.stack([-ahead[:, 1], ahead[:, 0]], axis=1))
        off_m = np.abs(things.half_m[rows][:, None, 0] - self.half_m[columns][None, :, 0])
        # The middle of a part is off by up to what is missing of it.
        a = np.where(things.has_ends[rows][:, None], a, np.maximum(np.abs(a) - off_m, 0.0))
        squared = a**2 + (2.0 * c) ** 2
        is_other = things.has_ends[rows][:, None] & (off_m > _SAME_HALF_M)
        turned = np.abs(np.einsum("ik,jk->ij", along[rows], ahead)) < np.cos(_SAME_TURN_RAD)
        is_long = (things.half_m[rows][:, None, 0] > _LONG_HALF_M) & (self.half_m[columns][None, :, 0] > _LONG_HALF_M)
        return np.where(is_other | (turned & is_long), np.inf, squared)

    def take(self, place: int, correction: Correction, gate_m: float) -> None:
        """Takes in what a drive saw: things that are there move towards it, others are born.

        Args:
            place: of the drive among all.
            correction: where it lies by now.
            gate_m: see `paired`.
        """
        things = correction.sights.things
        centre, along = correction.moved(things.centre), turned_by(things.along, correction.turn(things.centre))
        pairs = self.paired(things, centre, along, gate_m)
        # Half way: the next drives then decide; the joint solve makes it exact.
        self.centre[pairs[:, 1]] = 0.5 * (self.centre[pairs[:, 1]] + centre[pairs[:, 0]])
        new = np.setdiff1d(np.arange(len(things)), pairs[:, 0])
        self.kind = np.concatenate([self.kind, things.kind[new]])
        self.source = np.vstack([self.source, np.stack([np.full(len(new), place), new], axis=1)])
        self.centre = np.vstack([self.centre, centre[new]])
        self.along = np.vstack([self.along, along[new]])
        self.half_m = np.vstack([self.half_m, things.half_m[new]])
        for element, _ in correction.sights.lines:
            xy = stations(correction.moved(element.points[:, :2]))
            for run in self._uncovered(kind_of(element), xy, gate_m):
                self.lines.append(WorldLine.along(kind_of(element), (place, element), run))

    def twins(self, seen_in: Bool[np.ndarray, "n d"], gate_m: float) -> Bool[np.ndarray, " n"]:
        """Things that are another one seen a little aside: of its kind, so near, and no drive saw both.

        Args:
            seen_in: which drives saw each thing.
            gate_m: see `paired`.
        """
        is_twin = np.zeros(len(self.kind), dtype=bool)
        count = seen_in.sum(axis=1)
        near = cKDTree(self.centre).query_pairs(gate_m, output_type="ndarray") if len(self.kind) > 1 else []
        for a, b in sorted(tuple(pair) for pair in np.asarray(near, dtype=np.int64).reshape(-1, 2).tolist()):
            if self.kind[a] != self.kind[b] or is_twin[a] or is_twin[b] or (seen_in[a] & seen_in[b]).any():
                continue
            # The first drive to see it, or the base map, gives the name where both count alike.
            is_twin[b if count[a] >= count[b] else a] = True
        return is_twin

    def drop(self, rows: Bool[np.ndarray, " n"]) -> None:
        """Takes things out."""
        for name in ("kind", "source", "centre", "along", "half_m"):
            setattr(self, name, getattr(self, name)[~rows])

    def _uncovered(self, kind: str, xy: np.ndarray, gate_m: float) -> list[np.ndarray]:
        """Runs of a line that no line of the world covers."""
        own = [line.xy for line in self.lines if line.kind == kind]
        covered = np.zeros(len(xy), dtype=bool)
        if own:
            reach_m = np.hypot(gate_m, 0.5 * STATION_M)
            covered = cKDTree(np.concatenate(own)).query(xy, distance_upper_bound=reach_m)[0] < reach_m
        borders = np.flatnonzero(np.diff(np.concatenate([[False], ~covered, [False]]).astype(int)))
        runs = [xy[a:b] for a, b in borders.reshape(-1, 2)]
        return [run for run in runs if (len(run) - 1) * STATION_M >= LEAST_LINE_M]


def stations(xy: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "k c"]:
    """Places about a metre apart along a line, its ends among them."""
    xy = xy[np.append(True, np.linalg.norm(np.diff(xy[:, :2], axis=0), axis=1) > 1e-6)]
    if len(xy) < 2:
        return xy
    length_m = float(polyline.arc_length(xy)[-1])
    return polyline.interpolate(xy, np.linspace(0.0, length_m, max(round(length_m / STATION_M), 1) + 1))


@dataclass(frozen=True)
class Piece:
    """A line that a drive saw.

    Attributes:
        placed: `float64[k 3]` places about a metre apart where the drive places it [m].
        now: the same places where they are in the map by now, as a line.
        now_m: `float64[k]` arc length of each along `now`.
        sigma_m: of the line, across.
    """

    placed: Float[np.ndarray, "k 3"]
    now: shapely.LineString
    now_m: Float[np.ndarray, " k"]
    sigma_m: float

    @classmethod
    def of(cls, placed: np.ndarray, now: np.ndarray, sigma_m: float) -> "Piece":
        """The piece through these places."""
        return cls(placed, shapely.LineString(now), polyline.arc_length(now), sigma_m)


def line_sights(line: WorldLine, pieces: Sequence[Piece], gate_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where a drive saw a line: stations, the places it saw `[k 3]` as it placed them itself, their sigmas [m].

    Args:
        line: the line.
        pieces: lines of its kind that the drive saw.
        gate_m: none is farther aside than this.
    """
    xy, points = line.xy, shapely.points(line.xy)
    best = np.full(len(xy), gate_m)
    places, sigma = np.zeros((len(xy), 3)), np.zeros(len(xy))
    for piece in pieces:
        k = np.flatnonzero(shapely.dwithin(piece.now, points, np.hypot(gate_m, _BESIDE_M)))
        if not len(k):
            continue
        s_m = shapely.line_locate_point(piece.now, points[k])
        near, ahead, behind = (
            shapely.get_coordinates(shapely.line_interpolate_point(piece.now, np.clip(s_m + d, 0.0, piece.now.length)))
            for d in (0.0, 0.25, -0.25)
        )
        offset, left = near - xy[k], line.left[k]
        aside = (offset * left).sum(axis=1)
        beside = np.linalg.norm(offset - aside[:, None] * left, axis=1)
        step = (ahead - behind) / np.maximum(np.linalg.norm(ahead - behind, axis=1, keepdims=True), 1e-9)
        parallel = np.abs((step * left).sum(axis=1)) < np.sin(_SAME_TURN_RAD)
        better = (np.abs(aside) < best[k]) & (beside < _BESIDE_M) & parallel
        k, s_m = k[better], s_m[better]
        best[k], sigma[k] = np.abs(aside[better]), piece.sigma_m
        places[k] = np.column_stack([np.interp(s_m, piece.now_m, axis) for axis in piece.placed.T])
    seen = np.flatnonzero(best < gate_m)
    return seen, places[seen], sigma[seen]


def turned_by(along: Float[np.ndarray, "n 2"], angle_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    """Directions turned by small angles."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack([c * along[:, 0] - s * along[:, 1], s * along[:, 0] + c * along[:, 1]], axis=1)
