"""Everything that any drive has seen, each thing once (room: mapping; host).

In: Sights with their corrections. Out: CrowdWorld: things, lines as stations a metre apart; which sight is which.
A sight goes with a thing of its kind, one to one, nearest together; what is not near any is new.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from semloc_jax.evaluation.map_shapes import POSTS
from semloc_jax.mapping.crowd.correction import Correction
from semloc_jax.mapping.crowd.sights import Things
from semloc_jax.mapping.crowd.stations import STATION_M, runs_of
from semloc_jax.mapping.crowd.world_lines import SAME_TURN_RAD, WorldLine, all_of, distance_m, line_sights

LEAST_LINE_M = 3.0
_STRAND_M = 0.15
"""Lines of paint side by side are farther apart; what is nearer is one of them drawn twice."""
_SAME_HALF_M = 0.6
_LONG_HALF_M, _OVERLAP_M = 0.5, 0.5
"""What is longer has a direction; so much of two parts of a stop line is seen by both."""
HUNG, _REACH_SIGMAS = ("sign", "traffic_light"), 2.0
"""What stands on no ground that is seen is placed from afar: a drive that says so may have it up to two gates away."""
_POSTS = {label.name.lower() for label in POSTS}


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
            cost = self._apart(things, rows, columns, centre, along, kind in _POSTS)
            hangs = kind in HUNG
            reach_m = np.clip(_REACH_SIGMAS * things.sigma_m[rows, 1], gate_m, 2.0 * gate_m) if hangs else gate_m
            cost /= np.square(reach_m).reshape(-1, 1)
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
        # The middle of a part is off by up to what is missing of it. Of a stop line two drives may see two parts.
        open_ended = ~things.has_ends[rows][:, None]
        both_m = things.half_m[rows][:, None, 0] + self.half_m[columns][None, :, 0] - _OVERLAP_M
        slack_m = np.maximum(both_m, off_m) if (things.kind[rows] == "stop_line").all() else off_m
        a = np.where(open_ended, np.maximum(np.abs(a) - slack_m, 0.0), a)
        squared = a**2 + (2.0 * c) ** 2
        is_other = ~open_ended & (off_m > _SAME_HALF_M)
        turned = np.abs(np.einsum("ik,jk->ij", along[rows], ahead)) < np.cos(SAME_TURN_RAD)
        is_long = (things.half_m[rows][:, None, 0] > _LONG_HALF_M) & (self.half_m[columns][None, :, 0] > _LONG_HALF_M)
        return np.where(is_other | (turned & is_long), np.inf, squared)

    def take(self, place: int, correction: Correction, gate_m: float) -> None:
        """Takes in what a drive saw: things that are there move towards it, others are born; see `take_parts`.

        Args:
            place: of the drive among all.
            correction: where it lies by now.
            gate_m: see `paired`.
        """
        self._take_things(place, correction, gate_m, True)
        self._take_lines(place, correction, gate_m)

    def take_parts(self, place: int, correction: Correction, gate_m: float) -> None:
        """Takes in those parts of things that are none of any thing that is there: after all drives, since a part that
        one drive saw is of what another one sees whole."""
        self._take_things(place, correction, gate_m, False)

    def _take_things(self, place: int, correction: Correction, gate_m: float, whole: bool) -> None:
        things = correction.sights.things
        centre, along = correction.moved_things(), turned_by(things.along, correction.turn(things.centre))
        pairs = self.paired(things, centre, along, gate_m)
        is_whole = things.has_ends | correction.sights.is_base
        i, j = pairs[is_whole[pairs[:, 0]]].T
        # Half way: the next drives then decide; the joint solve makes it exact.
        self.centre[j] = 0.5 * (self.centre[j] + centre[i])
        new = np.setdiff1d(np.flatnonzero(is_whole == whole), pairs[:, 0])
        self.kind = np.concatenate([self.kind, things.kind[new]])
        self.source = np.vstack([self.source, np.stack([np.full(len(new), place), new], axis=1)])
        self.centre = np.vstack([self.centre, centre[new]])
        self.along = np.vstack([self.along, along[new]])
        self.half_m = np.vstack([self.half_m, things.half_m[new]])

    def _take_lines(self, place: int, correction: Correction, gate_m: float) -> None:
        """Lines of a drive, or runs of them, that are none of those known before; a base map names each of its own."""
        known: dict[str, list[WorldLine]] = {}
        for line in self.lines:
            known.setdefault(line.kind, []).append(line)
        is_base = correction.sights.is_base
        for kind, pieces in correction.pieces().items():
            lines = known.get(kind, [])
            seen = line_sights(lines, [piece for _, piece in pieces], gate_m)
            strands = all_of(lines)
            for k, (element, piece) in enumerate(pieces):
                is_old = piece.is_near(seen.s_m[seen.piece == k]) | (distance_m(strands, piece.now) < _STRAND_M)
                for a, b in runs_of(~is_old | is_base):
                    if is_base or (b - a - 1) * STATION_M >= LEAST_LINE_M:
                        self.lines.append(WorldLine.along(kind, (place, element), piece.now[a:b]))

    def twins(self, seen_in: Bool[np.ndarray, "n d"], gate_m: float) -> Bool[np.ndarray, " n"]:
        """Things that are another one seen a little aside: of its kind, so near, and no drive saw both.

        What hangs is placed from afar: two of them may be one up to two gates apart, as in `paired`.

        Args:
            seen_in: which drives saw each thing.
            gate_m: see `paired`.
        """
        is_twin = np.zeros(len(self.kind), dtype=bool)
        count = seen_in.sum(axis=1)
        near = cKDTree(self.centre).query_pairs(2.0 * gate_m, output_type="ndarray") if len(self.kind) > 1 else []
        for a, b in sorted(tuple(pair) for pair in np.asarray(near, dtype=np.int64).reshape(-1, 2).tolist()):
            if self.kind[a] != self.kind[b] or is_twin[a] or is_twin[b] or (seen_in[a] & seen_in[b]).any():
                continue
            if self.kind[a] not in HUNG and np.linalg.norm(self.centre[a] - self.centre[b]) > gate_m:
                continue
            # The first drive to see it, or the base map, gives the name where both count alike.
            is_twin[b if count[a] >= count[b] else a] = True
        return is_twin

    def drop(self, rows: Bool[np.ndarray, " n"]) -> None:
        """Takes things out."""
        for name in ("kind", "source", "centre", "along", "half_m"):
            setattr(self, name, getattr(self, name)[~rows])


def turned_by(along: Float[np.ndarray, "n 2"], angle_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    """Directions turned by small angles."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack([c * along[:, 0] - s * along[:, 1], s * along[:, 0] + c * along[:, 1]], axis=1)
