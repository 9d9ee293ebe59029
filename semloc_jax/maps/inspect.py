"""What a map holds and what is wrong with it (room: maps; host).

In: SemanticMap. Out: MapReport, which prints itself as text.
"""

import gzip
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import shapely

from semloc_jax.maps.columns import Columns
from semloc_jax.maps.defects import Defect, find_defects
from semloc_jax.maps.elements import GeoOrigin, MapElement
from semloc_jax.maps.io.compact import compact_bytes
from semloc_jax.maps.io.features import feature_from_element
from semloc_jax.maps.semantic_map import SemanticMap

_STRETCH, _STRETCHES = 400, 10
"""Elements of a stretch, and stretches, that stand for a map that has more; ours."""
_CELL_M, _MOST_CELLS, _STRIP_PX, _LINES_AT_ONCE = 2.5, 8.0e6, 256, 4096
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
    part: list[MapElement] = []
    columns = Columns.of(_noting(semantic_map, part))
    length_m = np.bincount(columns.name, weights=columns.length_m, minlength=len(columns.names))
    count = np.bincount(columns.name, minlength=len(columns.names))
    rows = zip(columns.names, count.tolist(), length_m.tolist(), strict=True)
    road_length_m = _road_length_m(columns)
    size, compact_size = _sizes(part, len(columns), semantic_map.origin)
    return MapReport(
        name=semantic_map.name,
        classes=tuple(ClassSummary(*row) for row in rows),
        extent_m=np.diff(columns.extent, axis=0)[0],
        road_length_m=road_length_m,
        bytes_per_km=size / max(road_length_m, 1.0) * 1000.0,
        num_points=len(columns.points),
        defects=tuple(find_defects(columns, semantic_map.skipped, semantic_map.faulty)),
        has_origin=semantic_map.origin is not None,
        compact_bytes_per_km=compact_size / max(road_length_m, 1.0) * 1000.0,
        frame=_frame(semantic_map),
        assumed=columns.assumed,
    )


def _noting(semantic_map: SemanticMap, part: list[MapElement]) -> Iterator[MapElement]:
    """Yields the elements of a map one by one and notes those that stand for the size of all.

    Of a large map these are some stretches of its list: what lies together there lies together on the road, so they are
    packed about as well as the whole.
    """
    num = semantic_map.num_elements
    starts = np.linspace(0, max(num - _STRETCH, 0), _STRETCHES).astype(int)
    is_noted = np.full(num, num <= _STRETCH * _STRETCHES)
    for start in starts:
        is_noted[start : start + _STRETCH] = True
    for row, element in enumerate(semantic_map.walk()):
        if row < num and is_noted[row]:
            part.append(element)
        yield element


def _sizes(part: Sequence[MapElement], num_elements: int, origin: GeoOrigin | None) -> tuple[float, float]:
    """Returns the bytes of a map as gzipped GeoJSON and in the compact form, from elements that stand for all."""
    text = json.dumps([feature_from_element(element, lambda points: points.round(3)) for element in part]).encode()
    times = num_elements / max(len(part), 1)
    packed = compact_bytes(SemanticMap(tuple(part), origin))
    return len(gzip.compress(text)) * times, len(packed) * times


def _frame(semantic_map: SemanticMap) -> str:
    """Returns the coordinate system of a map in words."""
    origin = semantic_map.origin
    name = semantic_map.frame or ("local metres" if origin is None else "east, north, up in metres")
    if origin is None:
        return f"{name}, place on the earth unknown"
    return f"{name} about {origin.lat_deg:.6f}, {origin.lon_deg:.6f}, {origin.alt_m:.1f} m (WGS84)"


def road_length_on_grid_m(columns: Columns) -> float:
    """Returns the same estimate from a picture of the map, whose cost grows with the area and not with the elements."""
    low = columns.extent[0, :2] - 2.0 * _ROAD_REACH_M
    high = columns.extent[1, :2] + 2.0 * _ROAD_REACH_M
    cell_m = max(_CELL_M, float(np.sqrt(np.prod(high - low) / _MOST_CELLS)))
    width, height = (np.ceil((high - low) / cell_m).astype(int) + 1).tolist()
    free = np.ones((height, width), dtype=np.uint8)
    for row in range(0, len(columns), _LINES_AT_ONCE):
        start = columns.start[row : row + _LINES_AT_ONCE + 1]
        pixels = np.rint((columns.points[start[0] : start[-1], :2] - low) / cell_m).astype(np.int32)
        cv2.polylines(free, np.split(pixels, start[1:-1] - start[0]), False, 0)
    around = _near_zero(free, _ROAD_REACH_M / cell_m)
    del free  # the components need four times as much
    parts = cv2.connectedComponents(around)[0] - 1
    return max(0.5 * cell_m * _outline_px(around) - parts * np.pi * _ROAD_REACH_M, 0.0)


def _near_zero(picture: np.ndarray, reach_px: float) -> np.ndarray:
    """Returns 1 where a pixel with 0 is nearer than `reach_px`, `uint8[h w]`; strip by strip: distances are large."""
    near, margin = np.zeros_like(picture), int(reach_px) + 3
    for top in range(0, len(picture), _STRIP_PX):
        first = max(top - margin, 0)
        distance_px = cv2.distanceTransform(picture[first : top + _STRIP_PX + margin], cv2.DIST_L2, 5)
        near[top : top + _STRIP_PX] = distance_px[top - first : top - first + _STRIP_PX] < reach_px
    return near


def _outline_px(picture: np.ndarray) -> float:
    """Returns the length of the outlines in a picture of 0 and 1 `[h w]`, after Crofton in four directions, in pixels.

    Strip by strip: a picture of the map has some million pixels, and skimage needs nine times as many bytes.
    """
    padded = np.pad(picture, 1)
    crossings = np.zeros(4)
    for top in range(0, len(padded), _STRIP_PX):
        strip = padded[top : top + _STRIP_PX + 1]
        steps = (
            strip[:-1, 1:] != strip[:-1, :-1],
            strip[1:, :-1] != strip[:-1, :-1],
            strip[1:, 1:] != strip[:-1, :-1],
            strip[1:, :-1] != strip[:-1, 1:],
        )
        crossings += [np.count_nonzero(step) for step in steps]
    return float(np.pi / 8.0 * (crossings[0] + crossings[1] + (crossings[2] + crossings[3]) / np.sqrt(2.0)))


def _road_length_m(columns: Columns) -> float:
    """Returns the length of the roads, estimated as half of the outline of everything within 15 m of an element."""
    if not len(columns):
        return 0.0
    if len(columns) > _STRETCH * _STRETCHES:
        return road_length_on_grid_m(columns)
    lines = [
        shapely.LineString(xy) if len(xy) > 1 else shapely.Point(xy[0])
        for xy in np.split(columns.points[:, :2], columns.start[1:-1])
    ]
    around = shapely.unary_union(shapely.buffer(np.array(lines, dtype=object), _ROAD_REACH_M, quad_segs=4))
    parts = len(shapely.get_parts(around))
    return max(0.5 * around.length - parts * np.pi * _ROAD_REACH_M, 0.0)
