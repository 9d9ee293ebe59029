"""What is wrong in a map (room: maps; host).

In: SemanticMap. Out: Defects: repeated, doubled, empty, self-crossing, without sizes or heights, gaps, under ground.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from semloc_jax.maps.curves import as_ring
from semloc_jax.maps.elements import UPRIGHT_CLASSES, MapElement
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.structs import ElementClass

_ZERO_LENGTH_M = 1e-3
_SAME_PLACE_M = 0.05
_WIDEST_GAP_M = 0.5
"""Ends of two solid lines that face each other nearer than this were meant to meet."""
_LONGEST_STEP_M = 2000.0
_FACING_COS = 0.96
_GROUND_REACH_M = 10.0
_UNDER_M = 0.3
_NEEDED_SIZE = {
    ElementClass.POLE: ("radius_m", "radius"),
    ElementClass.CONE: ("radius_m", "radius"),
    ElementClass.TRAFFIC_LIGHT: ("width_m", "width"),
    ElementClass.GUARDRAIL: ("height_m", "height"),
    ElementClass.LANE_MARKING: ("width_m", "width"),
}


@dataclass(frozen=True)
class Defect:
    """One thing that is wrong: what, with which element, and the numbers."""

    kind: str
    element: str
    detail: str


def find_defects(semantic_map: SemanticMap) -> Iterator[Defect]:
    """Yields everything that looks wrong in a map."""
    elements = semantic_map.elements
    for name, count in semantic_map.skipped.items():
        yield Defect("unknown class", name, f"{count} left out")
    for name, fault in semantic_map.faulty.items():
        yield Defect("left out", name, fault)
    has_heights = any(element.has_height for element in elements)
    seen: set[str] = set()
    for element in elements:
        if element.id in seen:
            yield Defect("repeated id", element.id, element.label.name)
        seen.add(element.id)
        length_m = element.length_m
        if length_m < _ZERO_LENGTH_M:
            yield Defect("zero length", element.id, f"{len(element.points)} points, {length_m * 1000:.3f} mm")
        elif _crosses_itself(element):
            yield Defect("crosses itself", element.id, f"{element.label.name}, {len(element.points)} points")
        step_m = float(np.linalg.norm(np.diff(element.points, axis=0), axis=1).max(initial=0.0))
        if step_m > _LONGEST_STEP_M:
            yield Defect("jump", element.id, f"{step_m / 1000.0:.1f} km from one vertex to the next")
        if has_heights and not element.has_height:
            yield Defect("missing heights", element.id, "taken from the road around it")
        yield from _missing_sizes(element)
    if elements and not has_heights:
        yield Defect("missing heights", "all elements", "the map is taken as flat")
    yield from _duplicates(elements)
    yield from _gaps(elements)
    yield from _under_ground(semantic_map)


def _missing_sizes(element: MapElement) -> Iterator[Defect]:
    field_name, word = _NEEDED_SIZE.get(element.label, ("", ""))
    if field_name and not element.closed and not element.is_logical and getattr(element, field_name) == 0.0:
        yield Defect("missing size", element.id, f"{element.label.name} without {word}; its middle is sampled")
    if element.label == ElementClass.PILLAR and element.height_m == 0.0:
        yield Defect("missing size", element.id, "PILLAR without height; it is not sampled")


def _crosses_itself(element: MapElement) -> bool:
    """Returns whether a line or area crosses itself seen from above (upright things always do)."""
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


def _gaps(elements: tuple[MapElement, ...]) -> Iterator[Defect]:
    """Yields pairs of solid lines of one class and width whose ends face each other and do not meet."""
    lines = [e for e in elements if e.style == "solid" and not e.closed and len(e.points) > 1 and e.length_m > 1.0]
    if not lines:
        return
    ends = np.array([end for e in lines for end in (e.points[0], e.points[-1])])
    outward = np.array([way for e in lines for way in (e.points[0] - e.points[1], e.points[-1] - e.points[-2])])
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    tree = cKDTree(ends)
    joined = np.array([len(near) > 1 for near in tree.query_ball_point(ends, _SAME_PLACE_M)])
    for one, other in sorted(tree.query_pairs(_WIDEST_GAP_M)):
        a, b = lines[one // 2], lines[other // 2]
        if joined[one] or joined[other] or a is b or a.label != b.label or a.width_m != b.width_m:
            continue
        step = ends[other] - ends[one]
        gap_m = float(np.linalg.norm(step))
        along = step @ outward[one]
        if outward[one] @ outward[other] < -_FACING_COS and along > _FACING_COS * gap_m:
            yield Defect("gap", a.id, f"{100.0 * gap_m:.0f} cm to {b.id}")


def _under_ground(semantic_map: SemanticMap) -> Iterator[Defect]:
    """Yields upright things that lie wholly below all road within 10 m."""
    upright = [
        e
        for e in semantic_map.elements
        if e.has_height and (e.label in UPRIGHT_CLASSES or e.label in (ElementClass.SIGN, ElementClass.PILLAR))
    ]
    ground = semantic_map.ground.points
    if not upright or not len(ground):
        return
    tree = cKDTree(ground[:, :2])
    near = tree.query_ball_point(np.array([e.points[0, :2] for e in upright]), _GROUND_REACH_M)
    for element, rows in zip(upright, near, strict=True):
        top = float(element.points[:, 2].max()) + (element.height_m if element.label == ElementClass.PILLAR else 0.0)
        if rows and top < float(ground[rows, 2].min()) - _UNDER_M:
            below_m = float(ground[rows, 2].min()) - top
            yield Defect("under ground", element.id, f"{element.label.name}, {below_m:.1f} m below the road")
