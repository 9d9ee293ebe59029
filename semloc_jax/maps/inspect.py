"""What a map holds and what is wrong with it (room: maps; host).

In: SemanticMap. Out: MapReport, which prints itself as text.
"""

import gzip
import json
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from semloc_jax.maps.curves import as_ring
from semloc_jax.maps.elements import UPRIGHT_CLASSES, MapElement
from semloc_jax.maps.io.features import feature_class, feature_from_element
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.structs import ElementClass

_ZERO_LENGTH_M = 1e-3
_SAME_PLACE_M = 0.05
_ROAD_REACH_M = 15.0
"""Lines nearer than twice this belong to one road when the length of the road is estimated."""
_NEEDED_SIZE = {
    ElementClass.POLE: ("radius_m", "radius"),
    ElementClass.CONE: ("radius_m", "radius"),
    ElementClass.TRAFFIC_LIGHT: ("width_m", "width"),
    ElementClass.GUARDRAIL: ("height_m", "height"),
    ElementClass.LANE_MARKING: ("width_m", "width"),
}


@dataclass(frozen=True)
class ClassSummary:
    """How much of one class a map holds."""

    name: str
    count: int
    length_m: float


@dataclass(frozen=True)
class Defect:
    """One thing that is wrong: what, with which element, and the numbers."""

    kind: str
    element: str
    detail: str


@dataclass(frozen=True)
class MapReport:
    """Contents, size and defects of a map.

    Attributes:
        name: of the map.
        classes: by class name of the GeoJSON layout.
        extent_m: size of the bounding box along x, y, z of the map frame.
        road_length_m: estimated length of the roads.
        bytes_per_km: size of the gzipped GeoJSON for each kilometre of road.
        num_points: vertices.
        defects: everything found.
        has_origin: whether the map knows its place on the earth.
    """

    name: str
    classes: tuple[ClassSummary, ...]
    extent_m: np.ndarray
    road_length_m: float
    bytes_per_km: float
    num_points: int
    defects: tuple[Defect, ...]
    has_origin: bool

    def to_text(self, max_defects: int = 20) -> str:
        """Returns the report as lines of text, with at most `max_defects` defects spelled out."""
        width, depth, height = self.extent_m
        lines = [
            f"map {self.name}: {sum(row.count for row in self.classes)} elements, {self.num_points} points",
            f"extent {width:.1f} x {depth:.1f} m, height {height:.1f} m",
            f"about {self.road_length_m / 1000:.2f} km of road, {self.bytes_per_km / 1000:.1f} kB/km gzipped",
            f"{'with' if self.has_origin else 'without'} a place on the earth",
            f"{'class':<16}{'count':>7}{'length [m]':>12}",
            *(f"{row.name:<16}{row.count:>7}{row.length_m:>12.1f}" for row in self.classes),
            f"defects: {len(self.defects) or 'none'}",
            *(f"  {d.kind}: {d.element} ({d.detail})" for d in self.defects[:max_defects]),
        ]
        if len(self.defects) > max_defects:
            lines.append(f"  ... and {len(self.defects) - max_defects} more")
        return "\n".join(lines)


def inspect_map(semantic_map: SemanticMap) -> MapReport:
    """Returns contents, size and defects of a map."""
    elements = semantic_map.elements
    groups: dict[str, list[MapElement]] = {}
    for element in elements:
        groups.setdefault(feature_class(element), []).append(element)
    classes = tuple(
        ClassSummary(name, len(group), sum(element.length_m for element in group)) for name, group in groups.items()
    )
    road_length_m = _road_length_m(elements)
    size = len(gzip.compress(json.dumps([feature_from_element(e, lambda p: p.round(3)) for e in elements]).encode()))
    return MapReport(
        name=semantic_map.name,
        classes=classes,
        extent_m=np.diff(semantic_map.extent, axis=0)[0] if elements else np.zeros(3),
        road_length_m=road_length_m,
        bytes_per_km=size / max(road_length_m, 1.0) * 1000.0,
        num_points=sum(len(element.points) for element in elements),
        defects=tuple(_defects(semantic_map)),
        has_origin=semantic_map.origin is not None,
    )


def _defects(semantic_map: SemanticMap) -> Iterator[Defect]:
    elements = semantic_map.elements
    for name, count in semantic_map.skipped.items():
        yield Defect("unknown class", name, f"{count} left out")
    has_heights = any(element.has_height for element in elements)
    seen: set[str] = set()
    for element in elements:
        if element.id in seen:
            yield Defect("repeated id", element.id, element.label.name)
        seen.add(element.id)
        if element.length_m < _ZERO_LENGTH_M:
            yield Defect("zero length", element.id, f"{len(element.points)} points, {element.length_m * 1000:.3f} mm")
        elif _crosses_itself(element):
            yield Defect("crosses itself", element.id, f"{element.label.name}, {len(element.points)} points")
        if has_heights and not element.has_height:
            yield Defect("missing heights", element.id, "taken as 0")
        yield from _missing_sizes(element)
    if elements and not has_heights:
        yield Defect("missing heights", "all elements", "the map is taken as flat")
    yield from _duplicates(elements)


def _missing_sizes(element: MapElement) -> Iterator[Defect]:
    field_name, word = _NEEDED_SIZE.get(element.label, ("", ""))
    if field_name and not element.closed and not element.is_logical and getattr(element, field_name) == 0.0:
        yield Defect("missing size", element.id, f"{element.label.name} without {word}; its middle is sampled")
    if element.label == ElementClass.PILLAR and element.height_m == 0.0:
        yield Defect("missing size", element.id, "PILLAR without height; it is not sampled")


def _crosses_itself(element: MapElement) -> bool:
    """Returns whether a line or area crosses itself seen from above (upright things always would)."""
    if element.label in UPRIGHT_CLASSES or element.label == ElementClass.SIGN or len(element.points) < 3:
        return False
    xy = element.points[:, :2]
    return not shapely.LineString(as_ring(xy) if element.closed else xy).is_simple


def _duplicates(elements: tuple[MapElement, ...]) -> Iterator[Defect]:
    """Yields pairs of one class with the same middle and the same length."""
    if not elements:
        return
    rows = np.array([[*e.points.mean(axis=0), e.length_m] for e in elements])
    for one, other in sorted(cKDTree(rows).query_pairs(_SAME_PLACE_M)):
        if elements[one].label == elements[other].label and elements[one].is_logical == elements[other].is_logical:
            gap_mm = 1000 * float(np.linalg.norm(rows[one, :3] - rows[other, :3]))
            yield Defect("duplicate", elements[other].id, f"{gap_mm:.0f} mm from {elements[one].id}")


def _road_length_m(elements: tuple[MapElement, ...]) -> float:
    """Returns the length of the roads, estimated as half of the outline of everything within 15 m of an element."""
    if not elements:
        return 0.0
    lines = [shapely.LineString(e.points[:, :2]) if len(e.points) > 1 else shapely.Point(e.points[0]) for e in elements]
    around = shapely.unary_union(shapely.buffer(np.array(lines, dtype=object), _ROAD_REACH_M, quad_segs=4))
    parts = len(shapely.get_parts(around))
    return max(0.5 * around.length - parts * np.pi * _ROAD_REACH_M, 0.0)
