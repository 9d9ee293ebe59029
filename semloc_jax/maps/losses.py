"""What a map loses when it is written to a file and read again (room: maps; host).

In: the map before and after. Out: Losses, which prints itself as text; it compares maps, so it knows no format.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.semantic_map import SemanticMap

_SIZES = ("width_m", "radius_m", "radius_top_m", "height_m")
_WORDS = ("style", "shape", "closed", "true_ends", "has_height")
_SAME_M = 1e-9
_UNSEEN_M = 1e-4
"""Points that move by less than this count as kept."""
_AT_ONCE = 256
_FARTHEST_M = 5.0
"""An element without a counterpart within this distance is lost."""


@dataclass(frozen=True)
class Losses:
    """Differences between a map and what came back from a file.

    Attributes:
        lost: elements that are not there any more, by class.
        added: elements that were not there before, by class.
        shift_m: largest distance of a vertex from the outline it belonged to, either way.
        changed: elements in which a field changed, by field; sizes with the largest change in metres.
        notes: other differences, as text.
    """

    lost: dict[str, int]
    added: dict[str, int]
    shift_m: float
    changed: dict[str, str]
    notes: tuple[str, ...]

    @property
    def is_exact(self) -> bool:
        """Whether nothing was lost, points to within a nanometre."""
        return not (self.lost or self.added or self.changed or self.notes) and self.shift_m <= _SAME_M

    @property
    def is_lossless(self) -> bool:
        """Whether nothing was lost, points to within what no map is made to: degrees in a file are rounded."""
        return not (self.lost or self.added or self.changed or self.notes) and self.shift_m <= _UNSEEN_M

    def to_text(self) -> str:
        """Returns the differences as lines of text."""
        if self.is_exact:
            return "nothing is lost: the map comes back exactly"
        lines = [f"lost: {count} {name}" for name, count in self.lost.items()]
        lines += [f"added: {count} {name}" for name, count in self.added.items()]
        lines.append(
            f"points move by at most {_length(self.shift_m)}" if self.shift_m > _SAME_M else "points are exact"
        )
        lines += [f"changed: {name} of {text}" for name, text in self.changed.items()]
        return "\n".join([*lines, *self.notes])


def compare(before: SemanticMap, after: SemanticMap) -> Losses:
    """Returns what differs between a map and what came back from a file; both in one frame.

    Elements are paired by id where all ids are alike, else with the nearest of their class.
    """
    pairs, lost, added, by_id = _pairs(before.elements, after.elements)
    notes = [] if by_id else ["ids are not kept"]
    if before.origin != after.origin:
        notes.append(f"place on the earth: {_place(before)} became {_place(after)}")
    if before.frame != after.frame:
        notes.append(f"name of the frame: '{before.frame}' became '{after.frame}'")
    notes += [f"left out when the map was read: {n} {name}" for name, n in before.skipped.items()]
    shift_m = max((_shift_m(one, other) for one, other in pairs), default=0.0)
    return Losses(_by_class(lost), _by_class(added), shift_m, _changed(pairs), tuple(notes))


def _pairs(
    before: tuple[MapElement, ...], after: tuple[MapElement, ...]
) -> tuple[list[tuple[MapElement, MapElement]], list[MapElement], list[MapElement], bool]:
    """Returns pairs of elements, those lost, those added, and whether ids paired them."""
    names = {element.id: element for element in after}
    common = [(element, names[element.id]) for element in before if element.id in names]
    if len(common) == len(before) and all(one.label == other.label for one, other in common):
        known = {element.id for element in before}
        return common, [], [element for element in after if element.id not in known], True
    pairs, lost, used = [], [], set()
    trees = {}
    for label in {element.label for element in after}:
        rows = [i for i, element in enumerate(after) if element.label == label]
        trees[label] = (rows, cKDTree(np.array([_key(after[i]) for i in rows])))
    for element in before:
        rows, tree = trees.get(element.label, ([], None))
        found = None
        if tree is not None:
            gaps, nearest = tree.query(_key(element), k=min(8, len(rows)), distance_upper_bound=_FARTHEST_M)
            hits = zip(np.atleast_1d(gaps), np.atleast_1d(nearest), strict=True)
            found = next((rows[k] for gap, k in hits if np.isfinite(gap) and rows[k] not in used), None)
        if found is None:
            lost.append(element)
        else:
            used.add(found)
            pairs.append((element, after[found]))
    return pairs, lost, [element for i, element in enumerate(after) if i not in used], False


def _key(element: MapElement) -> np.ndarray:
    """Returns the middle of the ends, the length and the width: alike for an element with fewer vertices."""
    ends = 0.5 * (element.points[0] + element.points[-1]) if not element.closed else element.points.mean(axis=0)
    return np.array([*ends, element.length_m, element.width_m])


def _shift_m(one: MapElement, other: MapElement) -> float:
    """Returns the largest distance of a vertex of either element from the other's line, in space."""
    if one.points.shape == other.points.shape:
        return float(np.linalg.norm(one.points - other.points, axis=1).max())
    return max(_away_m(one.points, other), _away_m(other.points, one))


def _away_m(points: np.ndarray, element: MapElement) -> float:
    line = np.vstack([element.points, element.points[:1]]) if element.closed else element.points
    if len(line) < 2:
        return float(np.linalg.norm(points - line, axis=1).max())
    start, step = line[:-1], np.diff(line, axis=0)
    squared = np.maximum(np.einsum("ks,ks->k", step, step), 1e-18)
    farthest = 0.0
    for first in range(0, len(points), _AT_ONCE):
        relative = points[first : first + _AT_ONCE, None] - start
        share = np.clip(np.einsum("nks,ks->nk", relative, step) / squared, 0.0, 1.0)
        gap = relative - share[..., None] * step
        farthest = max(farthest, float(np.linalg.norm(gap, axis=-1).min(axis=1).max()))
    return farthest


def _changed(pairs: list[tuple[MapElement, MapElement]]) -> dict[str, str]:
    found = {}
    for name in _SIZES:
        gaps = np.array([abs(getattr(one, name) - getattr(other, name)) for one, other in pairs])
        if (gaps > _SAME_M).any():
            found[name.removesuffix("_m")] = f"{int((gaps > _SAME_M).sum())}, by at most {_length(float(gaps.max()))}"
    for name in _WORDS:
        count = sum(getattr(one, name) != getattr(other, name) for one, other in pairs)
        found |= {name: str(count)} if count else {}
    count = sum(not _same_normal(one, other) for one, other in pairs)
    found |= {"normal": str(count)} if count else {}
    count = sum(
        any(key not in other.attributes or other.attributes[key] != value for key, value in one.attributes.items())
        for one, other in pairs
    )
    return found | ({"attributes": str(count)} if count else {})


def _same_normal(one: MapElement, other: MapElement) -> bool:
    if one.normal is None or other.normal is None:
        return one.normal is other.normal
    return bool(np.allclose(one.normal, other.normal, atol=1e-9))


def _by_class(elements: list[MapElement]) -> dict[str, int]:
    return dict(Counter(element.label.name.lower() for element in elements))


def _place(semantic_map: SemanticMap) -> str:
    origin = semantic_map.origin
    return "none" if origin is None else f"{origin.lat_deg:.6f}, {origin.lon_deg:.6f}, {origin.alt_m:.1f} m"


def _length(metres: float) -> str:
    if metres < 1e-4:
        return f"{1e6 * metres:.3g} micrometres"
    return f"{1000.0 * metres:.3g} mm" if metres < 1.0 else f"{metres:.3g} m"
