"""Pieces that wear has left of one dash, bar or bump are one again (room: mapping; host).

In: elements as they were drawn. Out: the same, pieces joined that together are as long as the others around them.
Dashes of one lane, bars of one crosswalk are painted alike: what lies in line, with a gap that no painter leaves, and
is whole with it, is one of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

_ALIKE_WITHIN_M = 40.0
"""Others of their kind that are so near are painted alike."""
_AS_LONG = 0.15
"""Share by which the whole may be longer or shorter than the others."""
_LONGEST_GAP = 0.35
"""Share of the length of the others that may be worn off between two pieces."""
_BUMP_GAP_M = 0.6
"""Pieces of a speed bump that are nearer are one, however long it is: humps that are set apart for wide axles leave
0.75 m and more, and there may be no other one around; ours."""
_OFF_M = 0.08
"""How far the ends of one piece may be off the line of the other, and either side of one off that of the other."""
_WHOLE = 3
"""Bars around a piece that must be whole to tell how far it reaches; ours."""
_CROSSWALK_M = 6.0
"""How far from a piece these are; ours."""
_LEAST_SHORT = 0.05
"""Share of the usual length by which a bar is no whole one; ours."""
_COS_ASKEW = float(np.cos(np.deg2rad(10.0)))
"""A short piece is turned no more against the bar that it is of; ours."""
_BARS = frozenset({ElementClass.CROSSWALK, ElementClass.STOP_LINE, ElementClass.SPEED_BUMP})


@dataclass(frozen=True)
class WornStroke:
    """A dash or bar as its middle line."""

    ends: Float[np.ndarray, "2 3"]
    width_m: float

    @classmethod
    def of(cls, element: MapElement) -> "WornStroke | None":
        """None for what is neither a dash nor a bar."""
        points = element.points
        if element.label == ElementClass.LANE_MARKING and element.style == "dashed":
            return cls(points[[0, -1]], element.width_m)
        if element.label not in _BARS or not element.closed or len(points) != 4:
            return None
        middles = 0.5 * (points + np.roll(points, -1, axis=0))
        one, other = middles[[3, 1]], middles[[0, 2]]
        long, wide = sorted((one, other), key=lambda m: -np.linalg.norm(m[1] - m[0]))
        return cls(long, float(np.linalg.norm(wide[1] - wide[0])))

    @property
    def length_m(self) -> float:
        """From end to end."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    @property
    def along(self) -> Float[np.ndarray, " 2"]:
        """Unit direction in the plane."""
        return (self.ends[1] - self.ends[0])[:2] / max(self.length_m, 1e-9)

    def holds(self, other: "WornStroke") -> bool:
        """Whether the middle of another one lies in this one."""
        off = other.ends[:, :2].mean(axis=0) - self.ends[:, :2].mean(axis=0)
        aside_m = abs(float(off @ [-self.along[1], self.along[0]]))
        return aside_m < 0.5 * self.width_m and abs(float(off @ self.along)) < 0.5 * self.length_m

    def joined(self, other: "WornStroke", usual_m: float, sure_gap_m: float = 0.0) -> "WornStroke | None":
        """Both as one, None where they are not pieces of one that is as long as usual or nearer than a sure gap."""
        if other.length_m > self.length_m:  # a short piece does not say where the line of both goes on
            return other.joined(self, usual_m, sure_gap_m)
        along = (self.ends[1] - self.ends[0])[:2] / max(self.length_m, 1e-9)
        off = (other.ends - self.ends[0])[:, :2]
        aside_m = np.abs(off @ [-along[1], along[0]])
        own, its = np.array([0.0, self.length_m]), np.sort(off @ along)
        gap_m = max(its[0] - own[1], own[0] - its[1])
        if aside_m.max() > _OFF_M or 0.5 * abs(self.width_m - other.width_m) > _OFF_M:
            return None
        if not 0.0 < gap_m < max(_LONGEST_GAP * usual_m, sure_gap_m):
            return None
        both = np.concatenate([self.ends, other.ends])
        order = np.argsort((both - self.ends[0])[:, :2] @ along)
        ends = both[order[[0, -1]]]
        share = float(np.linalg.norm(ends[1] - ends[0])) / usual_m
        if abs(share - 1.0) > _AS_LONG and gap_m >= sure_gap_m:
            return None
        lengths_m = np.array([self.length_m, other.length_m])
        return WornStroke(ends, float(lengths_m @ [self.width_m, other.width_m] / lengths_m.sum()))

    def element(self, like: MapElement) -> MapElement:
        """An element of this shape."""
        if not like.closed:
            num = max(round(self.length_m), 1) + 1
            return replace(like, points=np.linspace(*self.ends, num), width_m=self.width_m)
        along = (self.ends[1] - self.ends[0]) / self.length_m
        side = 0.5 * self.width_m * np.array([-along[1], along[0], 0.0])
        first, last = self.ends
        return replace(like, points=np.stack([first - side, last - side, last + side, first + side]))


def pieces_joined(elements: Sequence[MapElement]) -> list[MapElement]:
    """The elements, worn pieces of one dash or bar joined under the id of the first."""
    found = dict(enumerate(elements))
    strokes = {k: stroke for k, element in found.items() if (stroke := WornStroke.of(element)) is not None}
    for label in {elements[k].label for k in strokes}:
        _join({k: stroke for k, stroke in strokes.items() if elements[k].label == label}, found)
    return list(found.values())


def rows_completed(elements: Sequence[MapElement]) -> list[MapElement]:
    """The elements, pieces of bars of a crosswalk whole under the id of the longest (`completed`)."""
    found = dict(enumerate(elements))
    strokes = {k: WornStroke.of(e) for k, e in found.items() if e.label == ElementClass.CROSSWALK}
    bars = {k: stroke for k, stroke in strokes.items() if stroke is not None}
    rows = list(bars)
    for k, bar in completed(list(bars.values())).items():
        if bar is None:
            del found[rows[k]]
        else:
            found[rows[k]] = bar.element(found[rows[k]])
    return list(found.values())


def completed(bars: Sequence[WornStroke]) -> dict[int, WornStroke | None]:
    """The bars of crosswalks that were drawn anew, by row: pieces of one reach from border to border of the others.

    Bars of a crosswalk begin on one line and end on another. Where at least `_WHOLE` of them around a piece do, the
    piece is of a bar that does, too: the longest piece of each becomes that bar, the others (None) are parts of it.
    """
    lengths_m = np.array([bar.length_m for bar in bars])
    middles = np.array([bar.ends[:, :2].mean(axis=0) for bar in bars]).reshape(-1, 2)
    found: dict[int, WornStroke | None] = {}
    for k in np.argsort(-lengths_m, kind="stable"):
        near = np.flatnonzero(np.linalg.norm(middles - middles[k], axis=1) < _CROSSWALK_M)
        usual_m = _usual(lengths_m[near])
        if int(k) in found or lengths_m[k] > (1.0 - _LEAST_SHORT) * usual_m:
            continue
        whole = [bars[j] for j in near if abs(lengths_m[j] / usual_m - 1.0) < _LEAST_SHORT]
        bar = _between_borders(bars[k], whole)
        if bar is None:
            continue
        found[int(k)] = bar
        found |= {int(j): None for j in near if j != k and int(j) not in found and bar.holds(bars[j])}
    return found


def _between_borders(piece: WornStroke, whole: Sequence[WornStroke]) -> WornStroke | None:
    """The bar that a piece is of, by bars that are whole; None where these do not tell, or it is of another kind."""
    along = piece.along
    signs = [1.0 if bar.along @ along > 0.0 else -1.0 for bar in whole]
    alike = [(bar, sign) for bar, sign in zip(whole, signs, strict=True) if sign * (bar.along @ along) > _COS_ASKEW]
    if len(alike) < _WHOLE:
        return None
    direction = np.mean([sign * bar.along for bar, sign in alike], axis=0)
    direction /= np.linalg.norm(direction)
    across = np.array([-direction[1], direction[0]])
    middle = piece.ends[:, :2].mean(axis=0)
    ends = np.array([bar.ends[:: int(sign)] for bar, sign in alike])
    s_m, t_m = (ends[..., :2] - middle) @ across, (ends[..., :2] - middle) @ direction
    borders = [np.polynomial.Polynomial.fit(s_m[:, k], t_m[:, k], 1) for k in (0, 1)]
    off_m = max(np.abs(border(s_m[:, k]) - t_m[:, k]).max() for k, border in enumerate(borders))
    low_m, high_m = (float(border(0.0)) for border in borders)
    own_m = (piece.ends[:, :2] - middle) @ direction
    if off_m > _OFF_M or own_m.min() < low_m - _OFF_M or own_m.max() > high_m + _OFF_M:
        return None
    width_m = float(np.median([bar.width_m for bar, _ in alike]))
    if abs(piece.width_m - width_m) > 2.0 * _OFF_M:
        return None
    xy = middle + np.array([[low_m], [high_m]]) * direction
    return WornStroke(np.column_stack([xy, np.full(2, piece.ends[:, 2].mean())]), width_m)


def _join(strokes: dict[int, WornStroke], found: dict[int, MapElement]) -> None:
    """Joins the pieces among dashes or bars of one class in `found`."""
    rows = list(strokes)
    tree = cKDTree([stroke.ends[:, :2].mean(axis=0) for stroke in strokes.values()])
    lengths_m = np.array([stroke.length_m for stroke in strokes.values()])
    around = tree.query_ball_point(tree.data, _ALIKE_WITHIN_M)
    num = len(strokes)
    for one, other in sorted(tree.query_pairs(float(lengths_m.max()))):
        a, b = rows[one], rows[other]
        if a in strokes and b in strokes:
            sure_gap_m = _BUMP_GAP_M if found[a].label == ElementClass.SPEED_BUMP else 0.0
            whole = strokes[a].joined(strokes[b], _usual(lengths_m[around[one]]), sure_gap_m)
            if whole is not None:
                found[a], strokes[a] = whole.element(found[a]), whole
                del found[b], strokes[b]
    if len(strokes) < num:  # what is whole now tells better how long the others are, and has other neighbours
        _join(strokes, found)


def _usual(lengths_m: Float[np.ndarray, " k"]) -> float:
    """The length that most of the paint has: half of it is in longer ones."""
    ordered = np.sort(lengths_m)
    return float(ordered[np.searchsorted(np.cumsum(ordered), 0.5 * ordered.sum())])
