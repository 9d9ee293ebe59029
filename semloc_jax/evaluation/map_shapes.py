"""Map elements as what two maps are compared by: lines, things with two sides, posts, slots (room: evaluation; host).

In: elements of a map. Out: for each class its lines as points with directions, or its things as small records.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from semloc_jax.geometry import polyline
from semloc_jax.structs import ElementClass

LONGEST_THING_M = 12.0
"""A lane marking that is not called solid is one thing with two ends up to this length; a longer one, like a solid
one, is compared by the metre; our choice."""
STEP_M = 0.25
"""A line counts by places so far apart."""
VIRTUAL = "virtual"
_UNBROKEN = frozenset({"solid", "double"})

_LOGICAL_THINGS = frozenset({ElementClass.PARKING_SLOT, ElementClass.ROAD_MARK})
LINES = frozenset({ElementClass.CURB, ElementClass.GUARDRAIL})
POSTS = frozenset(
    {ElementClass.POLE, ElementClass.TRAFFIC_LIGHT, ElementClass.CONE, ElementClass.SIGN, ElementClass.PILLAR}
)
POST_NAMES = frozenset(label.name.lower() for label in POSTS)


@runtime_checkable
class Comparable(Protocol):
    """What an element of a map must show to be compared."""

    @property
    def id(self) -> str:
        """Its name."""

    @property
    def label(self) -> Any:
        """Its ElementClass."""

    @property
    def points(self) -> np.ndarray:
        """Its points `[k 3]` in the map frame [m]."""

    @property
    def closed(self) -> bool:
        """Whether the last point joins the first."""

    @property
    def true_ends(self) -> tuple[bool, bool]:
        """Whether the first and the last point end the paint."""

    @property
    def style(self) -> str:
        """solid, dashed, virtual ..."""

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Other properties: the type and the occupancy of a slot."""


@dataclass(frozen=True)
class Thing:
    """Something with two sides, or a post.

    Attributes:
        id: name of the element.
        corners: `float64[k 2]` outline or centre line from above [m].
        centre: `float64[2]` [m].
        along: unit `float64[2]` along its longest side; x east for posts, which have no side.
        ends: whether it ends at its low and at its high side along that direction, or goes on unseen.
        attributes: properties of the element.
    """

    id: str
    corners: Float[np.ndarray, "k 2"]
    centre: Float[np.ndarray, " 2"]
    along: Float[np.ndarray, " 2"]
    ends: tuple[bool, bool]
    attributes: Mapping[str, Any]


@dataclass(frozen=True)
class LinePlaces:
    """Places on the lines of one class, one every STEP_M.

    Attributes:
        points: `float64[n 2]` [m].
        along: unit `float64[n 2]`.
    """

    points: Float[np.ndarray, "n 2"]
    along: Float[np.ndarray, "n 2"]


def kinds(elements: Iterable[Comparable]) -> dict[str, list[Comparable]]:
    """Elements by the name under which they are compared: the class; lane markings as `line` and `dash`.

    Logical lines are left out; parking slots and the numbers painted in them stay.
    """
    found: dict[str, list[Comparable]] = {}
    for element in elements:
        if element.style == VIRTUAL and element.label not in _LOGICAL_THINGS:
            continue
        found.setdefault(kind_of(element), []).append(element)
    return found


def kind_of(element: Comparable) -> str:
    """The name under which an element is compared."""
    if element.label == ElementClass.LANE_MARKING:
        return "line" if is_line(element) else "dash"
    if element.label == ElementClass.ROAD_MARK and element.style == VIRTUAL:
        return "slot_number"
    return element.label.name.lower()


def is_line(element: Comparable) -> bool:
    """Whether an element is compared by the metre, not as one thing."""
    if element.closed or len(element.points) < 2:
        return False
    if element.label in LINES:
        return True
    if element.label != ElementClass.LANE_MARKING:
        return False
    xy = np.asarray(element.points)[:, :2]
    return element.style in _UNBROKEN or float(polyline.arc_length(xy)[-1]) > LONGEST_THING_M


def line_places(elements: Iterable[Comparable]) -> LinePlaces:
    """Places on lines."""
    points, along = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for element in elements:
        xy = np.asarray(element.points, dtype=np.float64)[:, :2]
        xy = xy[np.append(True, np.linalg.norm(np.diff(xy, axis=0), axis=1) > 1e-6)]
        if len(xy) < 2:
            continue
        length_m = float(polyline.arc_length(xy)[-1])
        s_m = (np.arange(max(round(length_m / STEP_M), 1)) + 0.5) * length_m / max(round(length_m / STEP_M), 1)
        points.append(polyline.interpolate(xy, s_m))
        along.append(polyline.tangent(xy, s_m))
    return LinePlaces(np.concatenate(points), np.concatenate(along))


def thing_of(element: Comparable) -> Thing:
    """An element as one thing."""
    xy = np.asarray(element.points, dtype=np.float64)[:, :2]
    if element.label in POSTS:
        foot = xy.mean(axis=0) if element.closed else xy[0]
        return Thing(element.id, xy, foot, np.array([1.0, 0.0]), (True, True), element.attributes)
    along = _main_direction(xy, element.closed)
    across = np.array([-along[1], along[0]])
    sides = np.stack([xy @ along, xy @ across], axis=1)
    middle = 0.5 * (sides.min(axis=0) + sides.max(axis=0))
    # The direction of an open line runs from its first to its last point.
    ends = (True, True) if element.closed else (bool(element.true_ends[0]), bool(element.true_ends[1]))
    return Thing(element.id, xy, middle[0] * along + middle[1] * across, along, ends, element.attributes)


def _main_direction(xy: Float[np.ndarray, "k 2"], closed: bool) -> Float[np.ndarray, " 2"]:
    """Direction of the longest extent: of a line from end to end, of an outline by the moments of its rim."""
    if not closed:
        step = xy[-1] - xy[0]
        length_m = float(np.linalg.norm(step))
        return step / length_m if length_m > 1e-9 else np.array([1.0, 0.0])
    edges = np.roll(xy, -1, axis=0) - xy
    lengths = np.linalg.norm(edges, axis=1)
    # Edges point along the sides: their doubled angles, by length squared, are steadier than moments of few corners.
    angle = np.arctan2(edges[:, 1], edges[:, 0])
    doubled = (lengths**2 * np.exp(2j * angle)).sum()
    turn = 0.5 * np.angle(doubled) if abs(doubled) > 1e-12 else 0.0
    return np.array([np.cos(turn), np.sin(turn)])
