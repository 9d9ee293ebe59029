"""Pieces that wear has left of one dash or one bar are one again (room: mapping; host).

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
_OFF_M = 0.08
"""How far the ends of one piece may be off the line of the other, and either side of one off that of the other."""
_BARS = frozenset({ElementClass.CROSSWALK, ElementClass.STOP_LINE})


@dataclass(frozen=True)
class _Stroke:
    """A dash or bar as its middle line."""

    ends: Float[np.ndarray, "2 3"]
    width_m: float

    @classmethod
    def of(cls, element: MapElement) -> "_Stroke | None":
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
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    def joined(self, other: "_Stroke", usual_m: float) -> "_Stroke | None":
        """Both as one, None where they are not pieces of one that is as long as usual."""
        along = (self.ends[1] - self.ends[0])[:2] / max(self.length_m, 1e-9)
        off = (other.ends - self.ends[0])[:, :2]
        aside_m = np.abs(off @ [-along[1], along[0]])
        own, its = np.array([0.0, self.length_m]), np.sort(off @ along)
        gap_m = max(its[0] - own[1], own[0] - its[1])
        if aside_m.max() > _OFF_M or 0.5 * abs(self.width_m - other.width_m) > _OFF_M:
            return None
        if not 0.0 < gap_m < _LONGEST_GAP * usual_m:
            return None
        both = np.concatenate([self.ends, other.ends])
        order = np.argsort((both - self.ends[0])[:, :2] @ along)
        ends = both[order[[0, -1]]]
        share = float(np.linalg.norm(ends[1] - ends[0])) / usual_m
        if abs(share - 1.0) > _AS_LONG:
            return None
        lengths_m = np.array([self.length_m, other.length_m])
        return _Stroke(ends, float(lengths_m @ [self.width_m, other.width_m] / lengths_m.sum()))

    def element(self, like: MapElement) -> MapElement:
        """An element of this shape."""
        if not like.closed:
            num = max(round(self.length_m), 1) + 1
            return replace(like, points=np.linspace(*self.ends, num), width_m=self.width_m)
        along = (self.ends[1] - self.ends[0]) / self.length_m
        side = 0.5 * self.width_m * np.array([-along[1], along[0], 0.0])
        first, last = self.ends
        return replace(like, points=np.stack([first - side, last - side, last + side, first + side]))


def whole_again(elements: Sequence[MapElement]) -> list[MapElement]:
    """The elements, worn pieces of one dash or bar joined under the id of the first."""
    found = dict(enumerate(elements))
    strokes = {k: stroke for k, element in found.items() if (stroke := _Stroke.of(element)) is not None}
    for label in {elements[k].label for k in strokes}:
        _join({k: stroke for k, stroke in strokes.items() if elements[k].label == label}, found)
    return list(found.values())


def _join(strokes: dict[int, _Stroke], found: dict[int, MapElement]) -> None:
    """Joins the pieces among dashes or bars of one class in `found`."""
    rows = list(strokes)
    tree = cKDTree([stroke.ends[:, :2].mean(axis=0) for stroke in strokes.values()])
    lengths_m = np.array([stroke.length_m for stroke in strokes.values()])
    around = tree.query_ball_point(tree.data, _ALIKE_WITHIN_M)
    for one, other in sorted(tree.query_pairs(float(lengths_m.max()))):
        a, b = rows[one], rows[other]
        if a in found and b in found:
            whole = strokes[a].joined(strokes[b], _usual(lengths_m[around[one]]))
            if whole is not None:
                found[a], strokes[a] = whole.element(found[a]), whole
                del found[b]


def _usual(lengths_m: Float[np.ndarray, " k"]) -> float:
    """The length that most of the paint has: half of it is in longer ones."""
    ordered = np.sort(lengths_m)
    return float(ordered[np.searchsorted(np.cumsum(ordered), 0.5 * ordered.sum())])
