"""What a map holds and what is wrong with it (room: maps; host).

In: SemanticMap. Out: MapReport, which prints itself as text.
"""

import gzip
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import shapely
from skimage import measure

from semloc_jax.maps.defects import Defect, find_defects
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.io.compact import compact_bytes
from semloc_jax.maps.io.features import feature_class, feature_from_element
from semloc_jax.maps.semantic_map import SemanticMap

_STRETCH, _STRETCHES = 1000, 10
"""Elements of a stretch, and stretches, that stand for a map that has more; ours."""
_CELL_M, _MOST_CELLS = 2.5, 2.0e7
_ROAD_REACH_M = 15.0
"""Lines nearer than twice this belong to one road when the length of the road is estimated."""


@dataclass(frozen=True)
class ClassSummary:
    """How much of one class a map holds."""

    name: str
    count: int
    length_m: float


@dataclass(frozen=True)
class MapReport:
    """Contents, size and defects of a map.

    Attributes:
        name: of the map.
        classes: by class name of the GeoJSON layout.
        extent_m: size of the bounding box along x, y, z of the map frame.
        road_length_m: estimated length of the roads.
        bytes_per_km: size of the gzipped GeoJSON for each kilometre of road.
        compact_bytes_per_km: size of the compact form at 1 cm for each kilometre of road.
        frame: coordinate system in words.
        assumed: number of elements for each size or position that the file does not state.
        num_points: vertices.
        defects: everything found.
        has_origin: whether the map knows its place on the earth.
    """

    name: str
    classes: tuple[ClassSummary, ...]
    extent_m: np.ndarray
    road_length_m: float
    bytes_per_km: float
    compact_bytes_per_km: float
    num_points: int
    defects: tuple[Defect, ...]
    has_origin: bool
    frame: str = ""
    assumed: Mapping[str, int] = field(default_factory=dict)

    def to_text(self, max_defects: int = 20) -> str:
        """Returns the report as lines of text, with at most `max_defects` defects spelled out."""
        width, depth, height = self.extent_m
        lines = [
            f"map {self.name}: {sum(row.count for row in self.classes)} elements, {self.num_points} points",
            f"extent {width:.1f} x {depth:.1f} m, height {height:.1f} m",
            f"about {self.road_length_m / 1000:.2f} km of road, {self.bytes_per_km / 1000:.1f} kB/km as gzipped "
            f"GeoJSON, {self.compact_bytes_per_km / 1000:.1f} kB/km compact at 1 cm",
            f"coordinates: {self.frame}",
            f"{'class':<16}{'count':>7}{'length [m]':>12}",
            *(f"{row.name:<16}{row.count:>7}{row.length_m:>12.1f}" for row in self.classes),
            *(f"assumed: {what} of {count} elements" for what, count in self.assumed.items()),
            f"defects: {len(self.defects) or 'none'}",
            *self._spelled_out(max_defects),
        ]
        return "\n".join(lines)

    def _spelled_out(self, max_defects: int) -> Iterator[str]:
        """Yields lines about defects; a frequent kind does not crowd out the others."""
        kinds: dict[str, list[Defect]] = {}
        for defect in self.defects:
            kinds.setdefault(defect.kind, []).append(defect)
        left = max_defects
        by_size = sorted(kinds.values(), key=len)
        shown = {}
        for index, found in enumerate(by_size):
            shown[found[0].kind] = min(len(found), left // (len(by_size) - index))
            left -= shown[found[0].kind]
        for kind, found in kinds.items():
            yield from (f"  {kind}: {defect.element} ({defect.detail})" for defect in found[: shown[kind]])
            if len(found) > shown[kind]:
                yield f"  ... and {len(found) - shown[kind]} more: {kind}"


def inspect_map(semantic_map: SemanticMap) -> MapReport:
    """Returns contents, size and defects of a map.

    >>> report = sj.inspect_map(street)
    >>> report.num_points, report.classes[0].name
    (6, 'lane_solid')
    """
    elements = semantic_map.elements
    groups: dict[str, list[MapElement]] = {}
    for element in elements:
        groups.setdefault(feature_class(element), []).append(element)
    classes = tuple(
        ClassSummary(name, len(group), sum(element.length_m for element in group)) for name, group in groups.items()
    )
    road_length_m = _road_length_m(elements)
    size, compact_size = _sizes(semantic_map)
    return MapReport(
        name=semantic_map.name,
        classes=classes,
        extent_m=np.diff(semantic_map.extent, axis=0)[0] if elements else np.zeros(3),
        road_length_m=road_length_m,
        bytes_per_km=size / max(road_length_m, 1.0) * 1000.0,
        num_points=sum(len(element.points) for element in elements),
        defects=tuple(find_defects(semantic_map)),
        has_origin=semantic_map.origin is not None,
        compact_bytes_per_km=compact_size / max(road_length_m, 1.0) * 1000.0,
        frame=_frame(semantic_map),
        assumed=Counter(what for element in elements for what in element.attributes.get("assumed", [])),
    )


def _sizes(semantic_map: SemanticMap) -> tuple[float, float]:
    """Returns the bytes of a map as gzipped GeoJSON and in the compact form.

    Of a large map some stretches of its list are packed and stand for all of it: what lies together there lies together
    on the road, so they are packed about as well as the whole.
    """
    elements = semantic_map.elements
    starts = np.linspace(0, max(len(elements) - _STRETCH, 0), _STRETCHES).astype(int)
    part = (
        elements if len(elements) <= _STRETCH * _STRETCHES else [e for s in starts for e in elements[s : s + _STRETCH]]
    )
    text = json.dumps([feature_from_element(element, lambda points: points.round(3)) for element in part]).encode()
    share = len(part) / max(len(elements), 1)
    packed = compact_bytes(SemanticMap(tuple(part), semantic_map.origin))
    return len(gzip.compress(text)) / max(share, 1e-9), len(packed) / max(share, 1e-9)


def _frame(semantic_map: SemanticMap) -> str:
    """Returns the coordinate system of a map in words."""
    origin = semantic_map.origin
    name = semantic_map.frame or ("local metres" if origin is None else "east, north, up in metres")
    if origin is None:
        return f"{name}, place on the earth unknown"
    return f"{name} about {origin.lat_deg:.6f}, {origin.lon_deg:.6f}, {origin.alt_m:.1f} m (WGS84)"


def road_length_on_grid_m(elements: Sequence[MapElement]) -> float:
    """Returns the same estimate from a picture of the map, whose cost grows with the area and not with the elements."""
    lines = [e.points[:, :2] for e in elements]
    low = np.min([line.min(axis=0) for line in lines], axis=0) - 2.0 * _ROAD_REACH_M
    high = np.max([line.max(axis=0) for line in lines], axis=0) + 2.0 * _ROAD_REACH_M
    cell_m = max(_CELL_M, float(np.sqrt(np.prod(high - low) / _MOST_CELLS)))
    width, height = (np.ceil((high - low) / cell_m).astype(int) + 1).tolist()
    free = np.ones((height, width), dtype=np.uint8)
    cv2.polylines(free, [np.rint((line - low) / cell_m).astype(np.int32) for line in lines], False, 0)
    around = cv2.distanceTransform(free, cv2.DIST_L2, 5) < _ROAD_REACH_M / cell_m
    parts = cv2.connectedComponents(around.astype(np.uint8))[0] - 1
    outline_m = cell_m * float(measure.perimeter_crofton(around, directions=4))
    return max(0.5 * outline_m - parts * np.pi * _ROAD_REACH_M, 0.0)


def _road_length_m(elements: tuple[MapElement, ...]) -> float:
    """Returns the length of the roads, estimated as half of the outline of everything within 15 m of an element."""
    if not elements:
        return 0.0
    if len(elements) > _STRETCH * _STRETCHES:
        return road_length_on_grid_m(elements)
    lines = [shapely.LineString(e.points[:, :2]) if len(e.points) > 1 else shapely.Point(e.points[0]) for e in elements]
    around = shapely.unary_union(shapely.buffer(np.array(lines, dtype=object), _ROAD_REACH_M, quad_segs=4))
    parts = len(shapely.get_parts(around))
    return max(0.5 * around.length - parts * np.pi * _ROAD_REACH_M, 0.0)
