"""How far two maps of one place agree, class by class (room: evaluation; host).

In: elements of a made map and of a reference. Out: MapComparison: precision, recall, F1, errors, moved, missing, added.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from semloc_jax.evaluation.map_shapes import (
    POST_NAMES,
    STEP_M,
    Comparable,
    LinePlaces,
    Thing,
    is_line,
    kinds,
    line_places,
    thing_of,
)
from semloc_jax.evaluation.metrics import Metric
from semloc_jax.structs import ElementClass

Seen = Callable[[Float[np.ndarray, "n 2"]], Bool[np.ndarray, " n"]]
"""Which places of the reference were looked at: what was never seen cannot be missing."""
MapAlignment = Literal["none", "se2"]

_SLOT = ElementClass.PARKING_SLOT.name.lower()
_GATES_M = (2.0, 1.0, 0.5, 0.3, 0.3, 0.3)
"""How far counterparts may be apart while the SE(2) alignment converges."""
_HUBER_M = 0.05
_ALIKE_M = 10.0
"""So far a line is off alike: it holds the motion of a map as one thing would, not as many times as it has places."""


@dataclass(frozen=True)
class MapTolerance:
    """When an element of a made map counts as found.

    Args:
        across_m: offset across the longest side, and of the corners of a slot.
        along_m: offset of either end along the longest side, and of the foot of a post.
        moved_m: a missing and an added element of one class so close are one that moved.
    """

    across_m: float = 0.10
    along_m: float = 0.25
    moved_m: float = 1.0


@dataclass(frozen=True)
class ClassComparison:
    """One class of two maps. Lines count by places a quarter of a metre apart, everything else by elements.

    Attributes:
        name: class; lane markings are `line` and `dash`.
        by_length: whether the counts are places on lines.
        num_made: of the made map.
        num_reference: of the reference, where it was looked at.
        found_made: of the made map, with a counterpart within tolerance.
        found_reference: of the reference, with a counterpart within tolerance.
        across_m: signed errors of what was found across its longest side.
        along_m: the same along it, of both ends as far as they were seen; empty for lines.
        moved: ids of the reference and of the made map that are one element which moved.
        missing: ids of the reference without a counterpart.
        added: ids of the made map without a counterpart.
        right_words: share of the slots found with the right occupancy, where both maps state it; nan without any.
    """

    name: str
    by_length: bool
    num_made: int
    num_reference: int
    found_made: int
    found_reference: int
    across_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    along_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    moved: tuple[tuple[str, str], ...] = ()
    missing: tuple[str, ...] = ()
    added: tuple[str, ...] = ()
    right_words: float = float("nan")

    @property
    def precision(self) -> float:
        """Share of the made map that is right."""
        return self.found_made / self.num_made if self.num_made else float("nan")

    @property
    def recall(self) -> float:
        """Share of the reference that was found."""
        return self.found_reference / self.num_reference if self.num_reference else float("nan")

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; 0 where one map has none of the class."""
        total = self.num_made + self.num_reference
        if not total or not (self.num_made and self.num_reference):
            return 0.0 if total else float("nan")
        both = self.precision + self.recall
        return 2.0 * self.precision * self.recall / both if both > 0.0 else 0.0


@dataclass(frozen=True)
class MapComparison:
    """Two maps compared.

    Attributes:
        classes: by name.
        T_reference_made: `float64[4 4]`, the motion that was taken out.
    """

    classes: dict[str, ClassComparison]
    T_reference_made: Float[np.ndarray, "4 4"]

    def metrics(self, prefix: str = "map") -> list[Metric]:
        """The comparison as metrics: `map.dash.f1`, `map.dash.rms_across_m` ..."""
        rows = []
        for name, item in self.classes.items():
            shares = {"precision": item.precision, "recall": item.recall, "f1": item.f1}
            rows += [Metric(f"{prefix}.{name}.{key}", v, "share", "higher", 0.02) for key, v in shares.items()]
            lengths = {"rms_across": _rms(item.across_m), "rms_along": _rms(item.along_m)}
            rows += [Metric(f"{prefix}.{name}.{key}", v, "m", "lower", 0.01) for key, v in lengths.items()]
            if not np.isnan(item.right_words):
                rows.append(Metric(f"{prefix}.{name}.occupancy", item.right_words, "share", "higher", 0.02))
        return rows

    def to_text(self) -> str:
        """A table, one row for each class."""
        head = f"{'class':<15}{'made':>6}{'ref.':>6}{'precision':>11}{'recall':>9}{'F1':>8}{'across':>10}{'along':>10}"
        lines = [head + f"{'moved':>7}{'missing':>9}{'added':>7}"]
        for name, item in self.classes.items():
            scale = STEP_M if item.by_length else 1.0
            unit = "m" if item.by_length else " "
            counts = f"{scale * item.num_made:>5.0f}{unit}{scale * item.num_reference:>5.0f}{unit}"
            shares = f"{_percent(item.precision):>11}{_percent(item.recall):>9}{_percent(item.f1):>8}"
            errors = f"{_cm(item.across_m):>10}{_cm(item.along_m):>10}"
            if item.by_length:
                lost = item.num_reference - item.found_reference, item.num_made - item.found_made
                rest = f"{'':>7}{STEP_M * lost[0]:>8.0f}m{STEP_M * lost[1]:>6.0f}m"
            else:
                rest = f"{len(item.moved):>7}{len(item.missing):>9}{len(item.added):>7}"
            lines.append(f"{name:<15}{counts}{shares}{errors}{rest}")
        return "\n".join(lines)


def compare_maps(
    made: Iterable[Comparable],
    reference: Iterable[Comparable],
    alignment: MapAlignment = "none",
    tolerance: MapTolerance | None = None,
    seen: Seen | None = None,
    T_reference_made: Float[np.ndarray, "4 4"] | None = None,
) -> MapComparison:
    """Compare a made map with a reference.

    Args:
        made: elements of the made map.
        reference: elements of the reference.
        alignment: `se2` first moves the made map in the plane onto the reference, by what both have.
        tolerance: when an element counts as found; None for 0.10 m across and 0.25 m along.
        seen: which places of the reference were looked at; None for all.
        T_reference_made: a first guess of the motion, for maps in frames of their own; None: within two metres.

    >>> compared = sj.compare_maps(street.elements[1:], street.elements)
    >>> {name: (item.precision, item.recall) for name, item in compared.classes.items()}
    {'line': (1.0, 0.5), 'stop_line': (1.0, 1.0)}
    """
    tolerance = tolerance or MapTolerance()
    guess = np.eye(4) if T_reference_made is None else np.asarray(T_reference_made, dtype=np.float64)
    ours, theirs = _Side.of(made), _Side.of(reference)
    moved = ours.moved(guess)
    if alignment == "se2":
        guess = _aligned(moved, theirs) @ guess
        moved = ours.moved(guess)
    seen = seen or (lambda points: np.ones(len(points), dtype=bool))
    classes: dict[str, ClassComparison] = {}
    for name in sorted({*moved.lines, *theirs.lines}):
        one, other = moved.lines.get(name, _NO_PLACES), theirs.lines.get(name, _NO_PLACES)
        looked = seen(other.points)
        shown = LinePlaces(other.points[looked], other.along[looked])
        classes[name] = _compare_lines(name, one, shown, other, tolerance)
    for name in sorted({*moved.things, *theirs.things}):
        one, other = moved.things.get(name, []), theirs.things.get(name, [])
        looked = [bool(seen(_key_places(thing)).all()) for thing in other]
        classes[name] = _compare_things(name, one, other, looked, tolerance)
    kept = {name: item for name, item in classes.items() if item.num_made or item.num_reference}
    return MapComparison(kept, guess)


_NO_PLACES = LinePlaces(np.zeros((0, 2)), np.zeros((0, 2)))


@dataclass(frozen=True)
class _Side:
    """One map: places on lines and things, by class."""

    lines: dict[str, LinePlaces]
    things: dict[str, list[Thing]]

    @classmethod
    def of(cls, elements: Iterable[Comparable]) -> "_Side":
        lines, things = {}, {}
        for name, group in kinds(elements).items():
            if long := [element for element in group if is_line(element)]:
                lines[name] = line_places(long)
            if short := [thing_of(element) for element in group if not is_line(element)]:
                things[name] = short
        return cls(lines, things)

    def moved(self, T: Float[np.ndarray, "4 4"]) -> "_Side":
        """The map moved in the plane."""
        R, t = T[:2, :2], T[:2, 3]
        lines = {name: LinePlaces(p.points @ R.T + t, p.along @ R.T) for name, p in self.lines.items()}
        things = {
            name: [
                Thing(
                    e.id,
                    e.corners @ R.T + t,
                    e.centre @ R.T + t,
                    e.along if name in POST_NAMES else R @ e.along,
                    e.ends,
                    e.attributes,
                )
                for e in group
            ]
            for name, group in self.things.items()
        }
        return _Side(lines, things)


def _key_places(thing: Thing) -> Float[np.ndarray, "k 2"]:
    return np.vstack([thing.centre, thing.corners])


def _compare_lines(
    name: str, made: LinePlaces, shown: LinePlaces, reference: LinePlaces, tolerance: MapTolerance
) -> ClassComparison:
    """Precision against the whole reference, recall over what was looked at."""
    across_m, is_right = _feet(made, reference, tolerance)
    _, is_found = _feet(shown, made, tolerance)
    return ClassComparison(
        name,
        True,
        len(made.points),
        len(shown.points),
        int(is_right.sum()),
        int(is_found.sum()),
        across_m=across_m[is_right],
    )


def _feet(places: LinePlaces, lines: LinePlaces, tolerance: MapTolerance) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance of places across the nearest line, and whether it is within tolerance."""
    if not len(places.points) or not len(lines.points):
        return np.zeros(len(places.points)), np.zeros(len(places.points), dtype=bool)
    _, index = cKDTree(lines.points).query(places.points)
    offset = places.points - lines.points[index]
    along = lines.along[index]
    across_m = offset[:, 1] * along[:, 0] - offset[:, 0] * along[:, 1]
    along_m = np.einsum("ij,ij->i", offset, along)
    near = (np.abs(across_m) <= tolerance.across_m) & (np.abs(along_m) <= tolerance.along_m + 0.5 * STEP_M)
    return across_m, near


def _compare_things(
    name: str, made: Sequence[Thing], reference: Sequence[Thing], looked: Sequence[bool], tolerance: MapTolerance
) -> ClassComparison:
    pairs = _pairs(made, reference, tolerance.moved_m)
    errors = {(i, j): _errors(name, made[i], reference[j]) for i, j in pairs}
    right = {pair for pair, error in errors.items() if _is_right(error, tolerance)}
    moved = [(i, j) for i, j in pairs if (i, j) not in right]
    paired_made = {i for i, _ in pairs}
    paired_reference = {j for _, j in pairs}
    found = [pair for pair in pairs if pair in right]
    words = [
        made[i].attributes["occupied"] == reference[j].attributes["occupied"]
        for i, j in found
        if "occupied" in made[i].attributes and "occupied" in reference[j].attributes
    ]
    return ClassComparison(
        name,
        False,
        len(made),
        # What is found was seen, whatever the picture of what was looked at says.
        sum(looked) + sum(not looked[j] for _, j in found),
        len(found),
        len(found),
        across_m=np.concatenate([errors[pair][0] for pair in found] or [np.zeros(0)]),
        along_m=np.concatenate([errors[pair][1] for pair in found] or [np.zeros(0)]),
        moved=tuple((reference[j].id, made[i].id) for i, j in moved),
        missing=tuple(thing.id for j, thing in enumerate(reference) if j not in paired_reference and looked[j]),
        added=tuple(thing.id for i, thing in enumerate(made) if i not in paired_made),
        right_words=float(np.mean(words)) if words else float("nan"),
    )


def _pairs(made: Sequence[Thing], reference: Sequence[Thing], reach_m: float) -> list[tuple[int, int]]:
    """One-to-one pairs with the least sum of distances between centres, none farther apart than `reach_m`."""
    if not made or not reference:
        return []
    centres = np.array([thing.centre for thing in made]), np.array([thing.centre for thing in reference])
    distance_m = np.linalg.norm(centres[0][:, None] - centres[1][None], axis=2)
    rows, columns = linear_sum_assignment(np.minimum(distance_m, reach_m) ** 2)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if distance_m[i, j] < reach_m]


def _errors(name: str, made: Thing, reference: Thing) -> tuple[np.ndarray, np.ndarray]:
    """Signed errors across (one of the middle, or of every corner) and along (of both ends) [m]."""
    if name in POST_NAMES:
        offset = made.centre - reference.centre
        return np.zeros(0), np.array([np.hypot(*offset)])
    if name == _SLOT:
        return _corner_errors(made.corners, reference.corners), np.zeros(0)
    along = reference.along
    across = np.array([-along[1], along[0]])
    ends = [np.array([(t.corners @ along).min(), (t.corners @ along).max()]) for t in (made, reference)]
    sides = [np.array([(t.corners @ across).min(), (t.corners @ across).max()]) for t in (made, reference)]
    made_ends = made.ends if made.along @ along > 0.0 else made.ends[::-1]
    # An end that was not seen says nothing about where the paint ends.
    known = np.logical_and(made_ends, reference.ends)
    return np.array([sides[0].mean() - sides[1].mean()]), (ends[0] - ends[1])[known]


def _corner_errors(made: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Distances of the corners in the order, either way round, that fits best; infinite for another number."""
    if len(made) != len(reference):
        return np.array([np.inf])
    orders = [np.roll(way, k, axis=0) for way in (made, made[::-1]) for k in range(len(made))]
    return min((np.linalg.norm(order - reference, axis=1) for order in orders), key=lambda d: float(d.max()))


def _is_right(error: tuple[np.ndarray, np.ndarray], tolerance: MapTolerance) -> bool:
    across_m, along_m = (np.abs(part).max(initial=0.0) for part in error)
    return bool(across_m <= tolerance.across_m and along_m <= tolerance.along_m)


def _aligned(made: _Side, reference: _Side) -> Float[np.ndarray, "4 4"]:
    """The motion in the plane that brings what both maps have closest together: robust, nearest counterparts anew."""
    T = np.eye(4)
    for gate_m in _GATES_M:
        points, offsets, normals, worth = _counterparts(made.moved(T), reference, gate_m)
        if len(points) < 3:
            return T
        centre = points.mean(axis=0)
        lever = points - centre
        turned = np.stack([-lever[:, 1], lever[:, 0]], axis=1)
        J = np.column_stack([normals, np.einsum("ij,ij->i", turned, normals)])
        r = np.einsum("ij,ij->i", offsets, normals)
        weight = _HUBER_M / np.maximum(np.abs(r), _HUBER_M)
        if gate_m == _GATES_M[-1]:  # before, lines keep bars from their neighbours
            weight = weight * worth
        step = np.linalg.lstsq(np.sqrt(weight)[:, None] * J, -np.sqrt(weight) * r, rcond=1e-6)[0]
        c, s = np.cos(step[2]), np.sin(step[2])
        motion = np.eye(4)
        motion[:2, :2] = [[c, -s], [s, c]]
        motion[:2, 3] = centre + step[:2] - motion[:2, :2] @ centre
        T = motion @ T
    return T


def _counterparts(made: _Side, reference: _Side, gate_m: float) -> tuple[np.ndarray, ...]:
    """Points of the made map, offsets from their counterparts, directions that these hold, what each counts."""
    points, offsets, normals, worth = [np.zeros((0, 2))], [np.zeros((0, 2))], [np.zeros((0, 2))], [np.zeros(0)]
    for name in made.lines.keys() & reference.lines.keys():
        one, other = made.lines[name], reference.lines[name]
        _, index = cKDTree(other.points).query(one.points)
        offset, along = one.points - other.points[index], other.along[index]
        near = np.linalg.norm(offset, axis=1) < gate_m
        points.append(one.points[near])
        offsets.append(offset[near])
        normals.append(np.stack([-along[near, 1], along[near, 0]], axis=1))
        worth.append(np.full(len(points[-1]), STEP_M / _ALIKE_M))
    for name in made.things.keys() & reference.things.keys():
        one, other = made.things[name], reference.things[name]
        for i, j in _pairs(one, other, gate_m):
            offset = one[i].centre - other[j].centre
            for axis in np.eye(2):
                points.append(one[i].centre[None])
                offsets.append(offset[None])
                normals.append(axis[None])
                worth.append(np.ones(1))
    return tuple(np.concatenate(parts) for parts in (points, offsets, normals, worth))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _percent(share: float) -> str:
    return "-" if np.isnan(share) else f"{100.0 * share:.1f} %"


def _cm(values: np.ndarray) -> str:
    return "-" if not len(values) else f"{100.0 * _rms(values):.1f} cm"
