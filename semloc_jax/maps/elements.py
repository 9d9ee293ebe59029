"""One element of a semantic vector map and the words for its class and style (room: maps; host).

In: numbers from a reader. Out: MapElement, GeoOrigin. Coordinates: local `map` frame [m], x east, y north, z up.
"""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array

from semloc_jax.errors import SemlocError
from semloc_jax.structs import ElementClass

Place = Sequence[float | int] | np.ndarray | Array
"""Coordinates of one place, `[2]` or `[3]`."""


LARGEST_M = 1e3
"""Beyond the size of anything that stands or is painted on a road."""

VIRTUAL = "virtual"
"""Style of what is kept but not sampled: lines that are not painted, signs of unknown height."""

PAINT_CLASSES = frozenset(
    {
        ElementClass.LANE_MARKING,
        ElementClass.STOP_LINE,
        ElementClass.CROSSWALK,
        ElementClass.ROAD_MARK,
        ElementClass.SLOT_LINE,
    }
)
"""Classes that are paint on the road: their points lie on the road surface and their edges are sampled."""

UPRIGHT_CLASSES = frozenset({ElementClass.POLE, ElementClass.TRAFFIC_LIGHT, ElementClass.CONE})
"""Classes stored as an axis of two points, base first."""


def element_class(name: ElementClass | str | int, where: str) -> ElementClass:
    """The class of that name or number.

    Raises:
        SemlocError: there is none.
    """
    if isinstance(name, ElementClass):
        return name
    try:
        return ElementClass(name) if isinstance(name, int | np.integer) else ElementClass[str(name).upper()]
    except (KeyError, ValueError):
        names = [label.name.lower() for label in ElementClass]
        close = difflib.get_close_matches(str(name).lower(), names, n=1)
        hint = f"did you mean '{close[0]}'? " if close else ""
        raise SemlocError(f"{where}: unknown class {name!r}; {hint}expected one of {', '.join(names)}") from None


class GeoOrigin(NamedTuple):
    """Where the local frame of a map sits on the earth: WGS84, ellipsoidal height."""

    lat_deg: float
    lon_deg: float
    alt_m: float = 0.0


@dataclass(frozen=True)
class MapElement:
    """One thing that can be seen: a line of paint, an area, a pole, a sign, a pillar.

    Attributes:
        id: name, unique in its map.
        label: class; a name such as "pole" becomes its ElementClass.
        points: `float64[k 3]` in the map frame [m]. Painted lines: centre line; areas, signs and pillars: outline
            without a repeated last point; poles, cones, traffic lights: base and top; guardrails: middle of the beam.
        closed: the last point joins the first.
        width_m: width of a painted line or of a traffic-light box; 0 where unknown or meaningless.
        radius_m: radius at the base of a pole or cone.
        radius_top_m: radius at its top.
        height_m: height of a pillar or bump above its points; top of a guardrail above the ground.
        style: solid, dashed, double ...; `virtual` for logical lines.
        shape: circle, triangle, rectangle ... of a sign; kind of an arrow.
        normal: unit `float64[3]` out of the face of a sign, or None.
        true_ends: whether the first and the last point are real ends (False where a query cut the line).
        has_height: whether the heights of the points were given (else they are 0).
        attributes: other properties of the file, kept for writing it back.
    """

    id: str
    label: ElementClass | str
    points: np.ndarray | Sequence
    closed: bool = False
    width_m: float = 0.0
    radius_m: float = 0.0
    radius_top_m: float = 0.0
    height_m: float = 0.0
    style: str = ""
    shape: str = ""
    normal: np.ndarray | None = None
    true_ends: tuple[bool, bool] = (True, True)
    has_height: bool = True
    attributes: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "label", element_class(self.label, f"map element '{self.id}'"))
        points = np.array(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
            raise SemlocError(f"map element '{self.id}': points of shape {points.shape}; expected [k 3], k >= 1")
        points.setflags(write=False)
        object.__setattr__(self, "points", points)

    @property
    def is_painted(self) -> bool:
        """Whether the element is paint on the road that a camera can see."""
        return self.label in PAINT_CLASSES and self.style != VIRTUAL

    @property
    def is_logical(self) -> bool:
        """Whether the element is logical (lane boundary, parking slot): it has no contour of its own."""
        return self.style == VIRTUAL or self.label == ElementClass.PARKING_SLOT

    @property
    def length_m(self) -> float:
        """Length of the line, or circumference of the outline [m]."""
        ring = np.vstack([self.points, self.points[:1]]) if self.closed else self.points
        step = ring[1:] - ring[:-1]
        return float(np.sqrt(np.einsum("ij,ij->i", step, step)).sum())

    def with_points(self, points: np.ndarray, true_ends: tuple[bool, bool] | None = None) -> "MapElement":
        """Returns the same element with other `points` `[k 3]`."""
        return replace(self, points=points, true_ends=self.true_ends if true_ends is None else true_ends)
