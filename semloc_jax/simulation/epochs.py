"""What changes in a world from one epoch to the next (room: simulation; host).

In: a World, a seed, the epoch. Out: the World of that epoch, and the list of changes of its map.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import MapElement
from semloc_jax.simulation import elements as make
from semloc_jax.simulation.paint import painted_shape
from semloc_jax.simulation.scene import World, class_name
from semloc_jax.structs import ElementClass

_UPRIGHT = (ElementClass.POLE, ElementClass.SIGN, ElementClass.TRAFFIC_LIGHT, ElementClass.CONE)
_MOVABLE = (*_UPRIGHT, ElementClass.STOP_LINE, ElementClass.CROSSWALK, ElementClass.ROAD_MARK)
_TOGETHER_M = {ElementClass.CROSSWALK: 1.6, ElementClass.POLE: 0.6}
"""Bars of a crosswalk, and a post with what hangs on it, share one fate: centres are at most so far apart."""
_CLEAR_M, _POST_CLEAR_M = 0.1, 0.8
_NUM_TRIES = 12
_SHAPES = ("circle", "triangle", "rectangle")
_LINE_WIDTHS_M = (0.12, 0.15, 0.2, 0.25)


@dataclass(frozen=True)
class ChangeShares:
    """How much of what can change does so from one epoch to the next, at least one thing of each kind of change."""

    removed: float = 0.03
    moved: float = 0.04
    added: float = 0.03
    repainted: float = 0.04


_SHARES = ChangeShares()


def at_epoch(world: World, key: Sequence[int], epoch: int) -> tuple[World, dict]:
    """The world after all changes up to an epoch, and the content of changes.json.

    Args:
        world: that of epoch 0.
        key: seed of the world; an epoch changes what it changes whichever epoch is asked for.
        epoch: 0 leaves everything as it is.
    """
    before = now = world
    for number in range(1, epoch + 1):
        before = now
        now = _next(now, np.random.default_rng([*key, number]), number)
    return now, {
        "epoch": epoch,
        "since_epoch_0": changes_between(world.elements, now.elements),
        "since_previous": changes_between(before.elements, now.elements),
    }


def changes_between(before: Sequence[MapElement], after: Sequence[MapElement]) -> list[dict]:
    """Entries {id, change, class, position [m] ...} that lead from one map to another; ids name the same thing."""
    old, new = {e.id: e for e in before}, {e.id: e for e in after}
    changes = []
    for name, element in old.items():
        entry = {"id": name, "change": "removed", "class": class_name(element), "position": _rounded(_middle(element))}
        if name not in new:
            changes.append(entry)
            continue
        delta = _middle(new[name]) - _middle(element)
        if np.abs(delta).max() > 1e-6:
            there = _rounded(_middle(new[name]))
            size_m = round(float(np.linalg.norm(delta)), 3)
            changes.append(
                {**entry, "change": "moved", "position_after": there, "delta": _rounded(delta), "distance_m": size_m}
            )
        looks = _look(element), _look(new[name])
        if looks[0] != looks[1]:
            changes.append(
                {**entry, "change": "repainted", "delta": _rounded(delta), "before": looks[0], "after": looks[1]}
            )
    added = [element for name, element in new.items() if name not in old]
    changes += [
        {"id": e.id, "change": "added", "class": class_name(e), "position": _rounded(_middle(e))} for e in added
    ]
    return changes


def _next(world: World, rng: np.random.Generator, epoch: int) -> World:
    """The world one epoch later."""
    things = _things(world.elements)
    loose = [thing for thing in things if _is_loose(thing)]
    order = rng.permutation(len(loose)).tolist()
    counts = [max(1, round(share * len(loose))) for share in (_SHARES.removed, _SHARES.moved, _SHARES.added)]
    ends = np.cumsum(counts).tolist()
    removed = {e.id for k in order[: ends[0]] for e in loose[k]}
    changed: dict[str, MapElement] = {}
    site = _Site(world)
    for k in order[ends[0] : ends[1]]:
        changed |= {e.id: e for e in site.moved(loose[k], rng)}
    added = [e for k in order[ends[1] : ends[2]] for e in site.copied(loose[k], rng, f"new{epoch}_")]
    plates = [e for e in world.elements if _look(e) and e.id not in removed and e.id not in changed]
    for k in rng.permutation(len(plates))[: max(1, round(_SHARES.repainted * len(plates)))].tolist():
        changed[plates[k].id] = _repainted(plates[k], rng)
    kept = [changed.get(e.id, e) for e in world.elements if e.id not in removed]
    return replace(world, elements=(*kept, *added))


def _is_loose(thing: Sequence[MapElement]) -> bool:
    """Whether a thing may go, come or move: short paint and what stands, no lights, no long lines, no building."""
    if any(e.is_logical or e.label == ElementClass.TRAFFIC_LIGHT for e in thing):
        return False
    return all(e.label in _MOVABLE or class_name(e) == "lane_dashed" for e in thing)


def _things(elements: Sequence[MapElement]) -> list[list[MapElement]]:
    """Elements that belong together: the bars of a crosswalk, a post and its signs."""
    groups = [{ElementClass.CROSSWALK}, {ElementClass.POLE, ElementClass.SIGN, ElementClass.TRAFFIC_LIGHT}]
    pairs = []
    for labels, reach_m in zip(groups, _TOGETHER_M.values(), strict=True):
        rows = np.array([k for k, e in enumerate(elements) if e.label in labels], dtype=int)
        if len(rows) > 1:
            xy = np.array([_middle(elements[k])[:2] for k in rows])
            pairs.append(rows[cKDTree(xy).query_pairs(reach_m, output_type="ndarray")])
    joined = np.vstack([np.zeros((0, 2), dtype=int), *pairs])
    graph = coo_matrix((np.ones(len(joined)), joined.T), shape=(len(elements), len(elements)))
    labels = connected_components(graph, directed=False)[1]
    things: dict[int, list[MapElement]] = {}
    for label, element in zip(labels.tolist(), elements, strict=True):
        things.setdefault(label, []).append(element)
    return list(things.values())


class _Site:
    """Where things of a world can be put: beside one another, paint on the road, posts where they stand already."""

    def __init__(self, world: World):
        self._surface, self._path = world.surface, world.along or world.path
        road = [shapely.Polygon(a.outline) for a in world.areas if a.class_id == CLASS_IDS["road"]]
        self._road = shapely.union_all([area if area.is_valid else area.buffer(0.0) for area in road])
        shapely.prepare(self._road)
        self._ids = [e.id for e in world.elements if not e.is_logical]
        self._shapes = [_footprint(e) for e in world.elements if not e.is_logical]
        self._tree = shapely.STRtree(self._shapes)
        # Cars come and go in slots: what they may stand on is no place for anything else, on whichever drive.
        slots = [e for e in world.elements if e.label == ElementClass.PARKING_SLOT]
        self._slots = shapely.union_all([shapely.Polygon(e.points[:, :2]) for e in slots])
        self._bodies = [body.bounds for body in world.bodies]
        self._new: list[shapely.Geometry] = []

    def moved(self, thing: Sequence[MapElement], rng: np.random.Generator) -> list[MapElement]:
        """The thing up to two metres from where it was; where it was if there is no room."""
        for _ in range(_NUM_TRIES):
            along_m, across_m = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 2.0), rng.uniform(-0.3, 0.3)
            candidate = self._shifted(thing, along_m, across_m)
            if self._is_free(thing, candidate):
                return candidate
        return list(thing)

    def copied(self, thing: Sequence[MapElement], rng: np.random.Generator, prefix: str) -> list[MapElement]:
        """A thing like this one some metres along the way, nothing if there is no room."""
        for _ in range(_NUM_TRIES):
            shift = self._shifted(thing, rng.choice([-1.0, 1.0]) * rng.uniform(3.0, 14.0), rng.uniform(-0.3, 0.3))
            candidate = [replace(e, id=f"{prefix}{e.id}") for e in shift]
            if self._is_free([], candidate):
                return candidate
        return []

    def _shifted(self, thing: Sequence[MapElement], along_m: float, across_m: float) -> list[MapElement]:
        middle = np.mean([_middle(element)[:2] for element in thing], axis=0)
        nearest = int(np.argmin(np.linalg.norm(self._path.xy - middle, axis=1)))
        heading = float(self._path.heading_rad[nearest])
        ahead, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
        return [self._on_ground(element, along_m * ahead + across_m * left) for element in thing]

    def _on_ground(self, element: MapElement, shift: np.ndarray) -> MapElement:
        """The element moved in the plane; paint follows the ground point by point, what stands keeps its shape."""
        xy = element.points[:, :2]
        old, new = self._surface.drape(xy)[:, 2], self._surface.drape(xy + shift)[:, 2]
        rise = new - old if element.label not in _UPRIGHT else np.full(len(xy), float(new[0] - old[0]))
        return make.shifted(element, np.column_stack([np.tile(shift, (len(xy), 1)), rise]))

    def _is_free(self, thing: Sequence[MapElement], candidate: Sequence[MapElement]) -> bool:
        """Whether it touches nothing else, and stands on the kind of ground it stood on."""
        own = {element.id for element in thing}
        for element in candidate:
            shape, is_upright = _footprint(element), element.label in _UPRIGHT
            if is_upright == shapely.intersects(self._road, shape) and element.label != ElementClass.CONE:
                # Paint belongs on the road; a post beside it, unless it hangs or stands there by design.
                if not is_upright or not self._stood_on_road(thing):
                    return False
            if not is_upright and not shapely.covers(self._road, shape):
                return False
            wide = shape.buffer(_POST_CLEAR_M if is_upright else _CLEAR_M)
            near = {self._ids[k] for k in self._tree.query(wide, predicate="intersects").tolist()}
            if near - own or any(other.intersects(wide) for other in self._new):
                return False
            if shapely.intersects(self._slots, shape) or (is_upright and self._is_in_body(element)):
                return False
        self._new += [_footprint(element) for element in candidate]
        return True

    def _stood_on_road(self, thing: Sequence[MapElement]) -> bool:
        return any(shapely.intersects(self._road, _footprint(element)) for element in thing)

    def _is_in_body(self, element: MapElement) -> bool:
        foot = element.points[0]
        return any(np.linalg.norm(center[:2] - foot[:2]) < radius for center, radius in self._bodies)


def _repainted(element: MapElement, rng: np.random.Generator) -> MapElement:
    """A sign of another shape, a line of another width."""
    if element.label == ElementClass.SIGN:
        shape = str(rng.choice([name for name in _SHAPES if name != element.shape]))
        normal, center = np.asarray(element.normal), np.array(element.attributes["center"])
        facing, size_m = float(np.arctan2(normal[1], normal[0])), float(element.attributes["width"])
        new = make.sign(element.id, center, facing, shape, size_m)
        return replace(new, attributes={**element.attributes, **new.attributes})
    width_m = float(rng.choice([width for width in _LINE_WIDTHS_M if abs(width - element.width_m) > 1e-6]))
    return replace(element, width_m=width_m, attributes={**element.attributes, "width": width_m})


def _look(element: MapElement) -> dict:
    """What paint can change without a move; empty where nothing can."""
    if element.label == ElementClass.SIGN:
        return {"shape": element.shape}
    if class_name(element) == "lane_solid":
        return {"width": element.width_m}
    return {}


def _middle(element: MapElement) -> np.ndarray:
    """Where an element is [3]: the stated centre of a sign, whose outline may change, else the mean of its points."""
    center = element.attributes.get("center")
    return np.array(center) if center is not None else element.points.mean(axis=0)


def _footprint(element: MapElement) -> shapely.Geometry:
    """What an element covers of the ground, seen from above."""
    if element.label in _UPRIGHT:
        return shapely.LineString(element.points[[0, -1], :2]).buffer(max(element.radius_m, 0.05))
    return painted_shape(element)


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(value), 3) for value in values]
