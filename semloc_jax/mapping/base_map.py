"""A map that is there already and what a new drive says of it: seen, missed, moved together, new (room: mapping; host).

In: a BeliefMap, beliefs in its elements by the new drive, elements that the drive made. Out: BeliefMap, Changes.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from semloc_jax.evaluation.map_shapes import POSTS, Thing, is_line, line_places, thing_of
from semloc_jax.geometry import polyline
from semloc_jax.mapping.sightings import UPRIGHT
from semloc_jax.mapping.uprights import Upright
from semloc_jax.maps import Belief, BeliefMap, MapElement, SharedSigmas
from semloc_jax.structs import ElementClass

_REACH_M = 30.0
_SHORT_POINTS = 12
"""A line beside slots with more points is compared by the metre."""
_SAME_SIZE_M = 0.5
Known = tuple[MapElement, Belief]
"""An element and the belief in it."""


@dataclass(frozen=True)
class BaseConfig:
    """How a map ages and how it takes a drive in. All values are ours.

    Args:
        survival: probability that an element is still there when the next drive comes.
        off_m: how far its lines may lie off where the drive sees them.
        same_m: elements of one class with middles no farther apart may be one thing.
        moved_m: where neither finds its like so near, up to this far the thing was moved.
        same_line_m: a line that runs no farther beside another is that line.
        new_line_m: shorter pieces of a line that the map does not hold are left out.
    """

    survival: float = 0.98
    off_m: float = 0.12
    same_m: float = 0.6
    moved_m: float = 1.5
    same_line_m: float = 0.3
    new_line_m: float = 3.0


@dataclass(frozen=True)
class Change:
    """One thing that the drive changed.

    Attributes:
        id: of the element.
        change: removed, moved or added.
        element: as it was, or as it is.
        existence: as the drive left it.
    """

    id: str
    change: str
    element: MapElement
    existence: float


@dataclass(frozen=True)
class Countable:
    """Elements of a map that a drive can see or miss.

    Attributes:
        paint: on the road, of classes that the masks show.
        uprights: poles, signs and traffic lights.
    """

    paint: list[MapElement]
    uprights: list[Upright]

    @classmethod
    def of(
        cls, base: BeliefMap | None, way: Float[np.ndarray, "n 2"], shown: Collection[ElementClass], uprights: bool
    ) -> "Countable":
        """Those near a way [m] of classes that are shown; none without a map."""
        near = [] if base is None else [e for e in base.map.elements if _is_near(e, way)]
        stand = [e for e in near if e.label in UPRIGHT] if uprights else []
        return cls(
            [e for e in near if e.is_painted and e.label in shown],
            [Upright(e, base.beliefs[e.id].sigma_across_m) for e in stand],
        )


def _is_near(element: MapElement, way: np.ndarray) -> bool:
    low, high = element.points[:, :2].min(axis=0) - _REACH_M, element.points[:, :2].max(axis=0) + _REACH_M
    return bool(((way >= low) & (way <= high)).all(axis=1).any())


def aged_logit(logit: float, survival: float) -> float:
    """Log odds of an element after the time between two drives: no map is surer than that time allows."""
    existence = survival / (1.0 + np.exp(-np.clip(logit, -50.0, 50.0)))
    return float(np.log(existence / (1.0 - existence)))


def taken_in(
    base: BeliefMap, looked_at: dict[str, Belief], made: Sequence[Known], config: BaseConfig | None = None
) -> tuple[BeliefMap, list[Change]]:
    """The map after a drive, and what changed.

    Args:
        base: the map before.
        looked_at: what the drive says of elements of the map: existence after it, its own counts and sigmas.
        made: what the drive made and believes in.
        config: None for the defaults.
    """
    config = config or BaseConfig()
    kept: dict[str, Known] = {}
    changes = []
    for element in base.map.elements:
        belief = _after(base.beliefs[element.id], looked_at.get(element.id), config)
        if belief.existence_logit > 0.0:
            kept[element.id] = element, belief
        else:
            changes.append(Change(element.id, "removed", element, belief.existence))
    new, moved = _new(kept, set(looked_at), made, config)
    changes += [Change(name, "moved", kept[name][0], kept[name][1].existence) for name in moved]
    for element, belief in new:
        name = _free_name(element.id, kept)
        kept[name] = replace(element, id=name), belief
        changes.append(Change(name, "added", kept[name][0], belief.existence))
    # The drive was laid in the map: what it brings is off by what is around it there.
    shared = SharedSigmas(base.as_map().elements)
    for name in (change.id for change in changes if change.change != "removed"):
        element, belief = kept[name]
        place_m, turn_rad = shared.at(element.points[:, :2].mean(axis=0))
        kept[name] = element, replace(belief, sigma_place_m=place_m, sigma_turn_rad=turn_rad)
    elements = tuple(element for element, _ in kept.values())
    return BeliefMap(base.map.with_elements(elements), {name: belief for name, (_, belief) in kept.items()}), changes


def _after(before: Belief, told: Belief | None, config: BaseConfig) -> Belief:
    if told is None:
        return replace(before, existence_logit=aged_logit(before.existence_logit, config.survival))
    return replace(
        before,
        existence_logit=told.existence_logit,
        num_seen=before.num_seen + told.num_seen,
        num_missed=before.num_missed + told.num_missed,
        first_seen_s=before.first_seen_s if before.first_seen_s is not None else told.first_seen_s,
        last_seen_s=told.last_seen_s if told.last_seen_s is not None else before.last_seen_s,
    )


def _new(
    kept: dict[str, Known], looked_at: set[str], made: Sequence[Known], config: BaseConfig
) -> tuple[list[Known], list[str]]:
    """What the map does not hold, and what was moved; what both hold is made one in `kept`."""
    found, moved = [], []
    for label in sorted({element.label for element, _ in made}):
        new = [known for known in made if known[0].label == label]
        old = [known for known in kept.values() if known[0].label == label]
        found += [piece for known in new if _is_long(known[0]) for piece in _beyond(known, old, config)]
        things = [known for known in new if not _is_long(known[0])]
        pairs = _pairs(things, [known for known in old if not _is_long(known[0])], config.same_m)
        for k, element in pairs.items():
            kept[element.id] = _together(kept[element.id], things[k])
        rest = [known for k, known in enumerate(things) if k not in pairs]
        taken = {element.id for element in pairs.values()}
        free = [k for k in old if k[0].id not in taken and k[0].id in looked_at and not _is_long(k[0])]
        pairs = _pairs(rest, free, config.moved_m)
        for k, known in enumerate(rest):
            if k in pairs and _same_size(pairs[k], known[0]):
                moved.append(pairs[k].id)
                kept[pairs[k].id] = replace(known[0], id=pairs[k].id), known[1]
            elif not _is_covered(known[0], old, config):
                found.append(known)
    return found, moved


def _is_long(element: MapElement) -> bool:
    return is_line(element) or (element.label == ElementClass.SLOT_LINE and len(element.points) > _SHORT_POINTS)


def _pairs(new: Sequence[Known], old: Sequence[Known], reach_m: float) -> dict[int, MapElement]:
    """Which element of the map each new one is: one to one, nearest middles together."""
    if not new or not old:
        return {}
    one, other = ([thing_of(element) for element, _ in side] for side in (new, old))
    distance_m = np.array([[_apart_m(a, b) for b in other] for a in one])
    rows, columns = linear_sum_assignment(np.minimum(distance_m, reach_m) ** 2)
    near = distance_m[rows, columns] < reach_m
    return {int(i): old[int(j)][0] for i, j in zip(rows[near], columns[near], strict=True)}


def _apart_m(one: Thing, other: Thing) -> float:
    """Distance of the middles; across a thing it counts twice: beside a dash lies another lane."""
    offset = one.centre - other.centre
    along = float(offset @ other.along)
    return float(np.hypot(along, 2.0 * (offset @ [-other.along[1], other.along[0]])))


def _together(before: Known, drive: Known) -> Known:
    """One element out of two views of it: its middle where both say, by what each knows."""
    (old, belief), (new, told) = before, drive
    weights = np.array([belief.sigma_across_m, told.sigma_across_m]) ** -2.0
    sigmas = [1.0 / np.sqrt(s**-2 + t**-2) for s, t in _sigmas(belief, told)]
    shift = np.zeros(3)
    shift[:2] = (thing_of(new).centre - thing_of(old).centre) * weights[1] / weights.sum()
    if old.label in POSTS or _same_size(old, new):
        old = old.with_points(old.points + shift)
    return old, replace(belief, sigma_across_m=sigmas[0], sigma_along_m=sigmas[1])


def _sigmas(one: Belief, other: Belief) -> list[tuple[float, float]]:
    return [(one.sigma_across_m, other.sigma_across_m), (one.sigma_along_m, other.sigma_along_m)]


def _same_size(one: MapElement, other: MapElement) -> bool:
    """Whether both show the whole thing: the middle of a part is elsewhere."""
    extents = [np.linalg.norm(np.ptp(element.points[:, :2], axis=0)) for element in (one, other)]
    return bool(all(one.true_ends) and all(other.true_ends) and abs(extents[0] - extents[1]) < _SAME_SIZE_M)


def _covered(xy: Float[np.ndarray, "n 2"], old: Sequence[Known], config: BaseConfig) -> Bool[np.ndarray, " n"]:
    """Which places lie on elements of the map."""
    places = line_places(replace(e, points=np.vstack([e.points, e.points[:1]])) if e.closed else e for e, _ in old)
    if not len(places.points) or not len(xy):
        return np.zeros(len(xy), bool)
    return cKDTree(places.points).query(xy)[0] < config.same_line_m


def _is_covered(element: MapElement, old: Sequence[Known], config: BaseConfig) -> bool:
    """Whether a short thing lies on a long one of the map: a piece of it."""
    if element.closed or element.label in POSTS:
        return False
    long = [known for known in old if _is_long(known[0])]
    return bool(_covered(_along(element), long, config).mean() > 0.5)


def _along(element: MapElement) -> Float[np.ndarray, "n 2"]:
    xy = element.points[:, :2]
    length_m = float(polyline.arc_length(xy)[-1])
    return polyline.interpolate(xy, np.linspace(0.0, length_m, max(round(length_m / 0.25), 1) + 1))


def _beyond(known: Known, old: Sequence[Known], config: BaseConfig) -> list[Known]:
    """The pieces of a long line that the map does not hold."""
    element, belief = known
    free = ~_covered(_along(element), old, config)
    length_m = float(polyline.arc_length(element.points[:, :2])[-1])
    s_m = np.linspace(0.0, length_m, len(free))
    borders = np.flatnonzero(np.diff(np.concatenate([[False], free, [False]]).astype(int)))
    pieces: list[Known] = []
    for start, end in borders.reshape(-1, 2):
        begin_m, stop_m = float(s_m[start]), float(s_m[end - 1])
        if stop_m - begin_m < config.new_line_m:
            continue
        num = max(round(stop_m - begin_m), 1) + 1
        points = polyline.interpolate(element.points, np.linspace(begin_m, stop_m, num))
        ends = (element.true_ends[0] and bool(start == 0), element.true_ends[1] and bool(end == len(free)))
        piece = replace(element, id=f"{element.id}_{len(pieces)}" if pieces else element.id)
        pieces.append((piece.with_points(points, ends), belief))
    return pieces


def _free_name(name: str, taken: dict[str, Known]) -> str:
    """The name, with a number where another element has it."""
    number = 2
    free = name
    while free in taken:
        free = f"{name}_{number}"
        number += 1
    return free
