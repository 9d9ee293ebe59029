"""The world that a real map describes: paint, curbs, rails, poles and signs (room: simulation; host).

In: a SemanticMap, the way to drive. Out: Scene, whose elements are the exact map, and what could not be built.
Sizes come from the elements. What a map has without a size gets one here, and the exact map says it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import shapely
from scipy.spatial import cKDTree

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.errors import SemlocError
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.simulation.height_field import surface_through
from semloc_jax.simulation.paint import GroundArea, PaintedGround, painted_shape, wear_pattern
from semloc_jax.simulation.path import PlanePath
from semloc_jax.simulation.scene import GREY, Scene, solid_of
from semloc_jax.simulation.solids import Box, Plate, Solid, car
from semloc_jax.simulation.surface import Surface
from semloc_jax.structs import ElementClass

_REACH_M = 160.0
"""What is farther from the way than this is not built."""
_LEVEL_M, _LEVEL_SHARE = 1.5, 0.12
"""Lines that are farther above or below the way than this, and this share of their distance, are on another deck."""
_SPACING_M = 1.0
_CURB_M = 0.15
"""Width of a curb stone whose line is its edge towards the road."""
_POLE_RADIUS_M = 0.06
_BEAM_M = (0.083, 0.312)
"""Depth and height of a W-beam (AASHTO M 180)."""
_HALF_LANE_M = 2.2
_ON_ROAD = frozenset(
    {
        ElementClass.LANE_MARKING,
        ElementClass.STOP_LINE,
        ElementClass.CROSSWALK,
        ElementClass.ROAD_MARK,
        ElementClass.SLOT_LINE,
        ElementClass.PARKING_SLOT,
        ElementClass.SPEED_BUMP,
        ElementClass.CURB,
    }
)
_MASK_CLASS = {
    ElementClass.STOP_LINE: "stop_line",
    ElementClass.CROSSWALK: "crosswalk",
    ElementClass.ROAD_MARK: "arrow",
    ElementClass.SLOT_LINE: "slot_line",
    ElementClass.SPEED_BUMP: "speed_bump",
    ElementClass.POLE: "pole",
    ElementClass.SIGN: "sign",
    ElementClass.TRAFFIC_LIGHT: "traffic_light",
    ElementClass.PILLAR: "pillar",
    ElementClass.CONE: "cone",
    ElementClass.CURB: "curb",
    ElementClass.GUARDRAIL: "guardrail",
}
"""Names of classes in masks; lane markings are lane_solid or lane_dashed."""
_SOLID_CLASSES = (ElementClass.POLE, ElementClass.CONE, ElementClass.TRAFFIC_LIGHT, ElementClass.SIGN)


@dataclass(frozen=True)
class MapWorld:
    """What was built of a map.

    Args:
        scene: the world.
        left_out: what could not be built, with counts.
        height_error_m: how far the lines of the map lie off the ground, RMS and largest [m].
    """

    scene: Scene
    left_out: dict[str, int]
    height_error_m: tuple[float, float]


def build_map_world(
    semantic_map: SemanticMap,
    lanes: Sequence[np.ndarray],
    path: PlanePath,
    length_m: float,
    speed_mps: float,
    wear_share: float,
    rng: np.random.Generator,
    traffic_rng: np.random.Generator | None = None,
) -> MapWorld:
    """The world around a way on a map.

    Raises:
        SemlocError: nothing along the way can be seen.
    """
    way = path.at(np.arange(0.0, length_m + 1.0, 1.0))
    low, high = way.min(axis=0) - _REACH_M, way.max(axis=0) + _REACH_M
    near = [e for e in semantic_map.elements if _meets(e, low, high)]
    lines = [lane for lane in lanes if np.all((lane[:, :2] > low) & (lane[:, :2] < high), axis=1).any()]
    road = _road_points(near, lines, way)
    road = road[np.all((road[:, :2] > low) & (road[:, :2] < high), axis=1)]
    surface = surface_through(road, low, high)
    off = road[:, 2] - surface.height(road[:, 0], road[:, 1])

    reference = cKDTree(np.vstack([*(lane[:, :2] for lane in lines), way]))
    region = shapely.box(*low, *high)
    built = _build_all([_on_ground(e, surface, low, high) for e in near], reference, surface, region)
    if all(element.is_logical for element in built.elements):
        raise SemlocError(
            f"map {semantic_map.name} has nothing to see within {_REACH_M:.0f} m of the way; start elsewhere"
        )
    areas = [GroundArea(CLASS_IDS["road"], outline) for outline in _road_outlines(lines, way, region)]
    paint = (built.shapes, built.class_ids)
    ground = PaintedGround(*paint, areas, CLASS_IDS["terrain"], wear_pattern(wear_share, rng))
    of_traffic = traffic_rng or rng
    gap_m, color = of_traffic.uniform(18.0, 30.0), tuple(of_traffic.uniform(0.1, 0.8, 3))

    def traffic(time_s: float) -> Sequence[Solid]:
        return _car_ahead(path, surface, gap_m + speed_mps * time_s, color)

    scene = Scene(tuple(built.elements), surface, ground, tuple(built.solids), traffic, path, CLASS_IDS["sky"])
    return MapWorld(scene, dict(built.left_out), (float(np.sqrt(np.mean(off**2))), float(np.abs(off).max())))


class _Built(NamedTuple):
    """What is built of the elements of a map: paint by shape and class, solids, and what cannot be built."""

    elements: list[MapElement]
    shapes: list[shapely.Geometry]
    class_ids: list[int]
    solids: list[Solid]
    left_out: Counter[str]


def _build_all(near: Sequence[MapElement], reference: cKDTree, surface: Surface, region: shapely.Geometry) -> _Built:
    """The elements as paint inside a region and as solids; logical ones are kept as they are."""
    found = _Built([], [], [], [], Counter())
    for element in near:
        if element.is_logical:
            found.elements.append(element)
            continue
        built = _built(element, reference, surface)
        if built is None:
            found.left_out[element.label.name.lower()] += 1
            continue
        true, shape, own_solids = built
        found.elements.append(true)
        found.solids.extend(own_solids)
        if shape is not None:
            found.shapes.append(shapely.intersection(shape, region))
            found.class_ids.append(CLASS_IDS[str(true.attributes["class"])])
    return found


def _meets(element: MapElement, low: np.ndarray, high: np.ndarray) -> bool:
    points = element.points[:, :2]
    return bool(np.all((points.max(axis=0) > low) & (points.min(axis=0) < high)))


def _road_points(elements: Sequence[MapElement], lanes: Sequence[np.ndarray], way: np.ndarray) -> np.ndarray:
    """Points of the road that the way is on `[n 3]`: lines of the map that have heights, other decks left out."""
    has_heights = any(element.has_height for element in elements)
    lines = [e.points for e in elements if e.label in _ON_ROAD and e.has_height == has_heights] + list(lanes)
    if not lines:
        lines = [e.points[:1] for e in elements if e.has_height == has_heights]
    points = np.vstack([_divided(line, 2.0 * _SPACING_M) for line in lines])
    tree = cKDTree(points[:, :2])
    height, heights = None, []
    for place in way:
        around = points[tree.query_ball_point(place, 4.0), 2]
        if len(around):
            # Stay on the level of the way so far.
            height = float(around[np.argmin(np.abs(around - height))] if height is not None else np.median(around))
        heights.append(height)
    known = np.array([np.nan if h is None else h for h in heights])
    if np.isnan(known).all():
        return points
    known = np.interp(np.arange(len(way)), np.flatnonzero(~np.isnan(known)), known[~np.isnan(known)])
    away, nearest = cKDTree(way).query(points[:, :2])
    return points[np.abs(points[:, 2] - known[nearest]) < _LEVEL_M + _LEVEL_SHARE * away]


def _on_ground(element: MapElement, surface: Surface, low: np.ndarray, high: np.ndarray) -> MapElement:
    """The element with what lies on the road lying on the ground; what stands keeps its height."""
    points = element.points
    if not element.has_height:
        return element
    if element.label not in _ON_ROAD:
        return element
    if surface.max_slope > 0.0:
        ring = np.vstack([points, points[:1]]) if element.closed else points
        points = _divided(ring, _SPACING_M)[: -1 if element.closed else None]
    inside = np.all((points[:, :2] > low) & (points[:, :2] < high), axis=1)
    height = np.where(inside, surface.height(points[:, 0], points[:, 1]), points[:, 2])
    return element.with_points(np.column_stack([points[:, :2], height]))


def _built(
    element: MapElement, reference: cKDTree, surface: Surface
) -> tuple[MapElement, shapely.Geometry | None, list[Solid]] | None:
    """The element as it stands in the world, its paint on the ground and its bodies; None where it has no size."""
    name = _MASK_CLASS.get(element.label) or ("lane_dashed" if element.style == "dashed" else "lane_solid")
    # What a reader assumed is what is built: in this world it is known.
    told = {key: value for key, value in element.attributes.items() if key != "assumed"}
    element = replace(element, attributes={**told, "class": name})
    if element.label in _SOLID_CLASSES:
        return _standing(element, surface)
    if element.label == ElementClass.PILLAR:
        return (element, None, _walls(element)) if element.closed and element.height_m > 0.0 else None
    if element.label == ElementClass.GUARDRAIL:
        return (element, None, _beams(element)) if element.height_m > 0.0 and len(element.points) > 1 else None
    if element.closed or element.width_m > 0.0:
        return element, painted_shape(element), []
    if element.label == ElementClass.CURB and len(element.points) > 1:
        return element, _curb_stone(element.points[:, :2], reference), []
    return None


def _standing(element: MapElement, surface: Surface) -> tuple[MapElement, None, list[Solid]] | None:
    """Poles, cones and lights upright on their base, or on the ground above it; signs unchanged."""
    if element.label == ElementClass.SIGN:
        return (element, None, [solid_of(element)]) if element.closed and len(element.points) > 2 else None
    base, top = element.points[0].copy(), element.points[-1]
    # What the ground hides of a post is no part of what can be seen.
    base[2] = max(base[2], float(surface.drape(base[None, :2])[0, 2]))
    if top[2] - base[2] < 0.05:
        return None
    if element.label == ElementClass.TRAFFIC_LIGHT:
        element = replace(element, width_m=element.width_m or 0.3)
    else:
        radius = element.radius_m or _POLE_RADIUS_M
        element = replace(element, radius_m=radius, radius_top_m=element.radius_top_m or radius)
        attributes = {**element.attributes, "radius": radius, "radius_top": element.radius_top_m}
        element = replace(element, attributes=attributes)
    element = element.with_points(np.array([base, [base[0], base[1], top[2]]]))
    return element, None, [solid_of(element)]


def _walls(element: MapElement) -> list[Solid]:
    """The upright sides of a pillar."""
    up = np.array([0.0, 0.0, element.height_m])
    feet = element.points
    color = (0.6, 0.62, 0.62)
    return [
        Plate(CLASS_IDS["pillar"], color, np.array([a, b, b + up, a + up]))
        for a, b in zip(feet, np.roll(feet, -1, axis=0), strict=True)
    ]


def _beams(element: MapElement) -> list[Solid]:
    """A rail as boxes from vertex to vertex of the middle of its beam."""
    beams: list[Solid] = []
    for start, end in zip(element.points[:-1], element.points[1:], strict=True):
        along = end - start
        length = float(np.linalg.norm(along))
        if length < 1e-3:
            continue
        along = along / length
        left = np.array([-along[1], along[0], 0.0]) / np.hypot(along[0], along[1])
        axes = np.stack([along, left, np.cross(along, left)], axis=1)
        beams.append(Box(CLASS_IDS["guardrail"], GREY, 0.5 * (start + end), (length, *_BEAM_M), axes))
    return beams


def _curb_stone(line: np.ndarray, reference: cKDTree) -> shapely.Geometry:
    """The stones along a curb line, on the side away from the road."""
    middle = _divided(np.column_stack([line, np.zeros(len(line))]), 1.0)[:, :2]
    step = np.gradient(middle, axis=0)
    _, nearest = reference.query(middle)
    towards = reference.data[nearest] - middle
    side = step[:, 0] * towards[:, 1] - step[:, 1] * towards[:, 0]
    sign = -1.0 if np.median(np.sign(side)) > 0.0 else 1.0
    return shapely.LineString(line).buffer(sign * _CURB_M, single_sided=True, join_style="mitre")


def _road_outlines(lanes: Sequence[np.ndarray], way: np.ndarray, region: shapely.Polygon) -> list[np.ndarray]:
    """Outlines of the asphalt: the lanes, and the way with half a lane on both sides."""
    ribbons = [shapely.LineString(lane[:, :2]).buffer(_HALF_LANE_M, cap_style="flat") for lane in lanes]
    ribbons.append(shapely.LineString(way).buffer(2.0 * _HALF_LANE_M, cap_style="flat"))
    whole = shapely.intersection(shapely.unary_union(ribbons).simplify(0.05), region)
    return [np.array(part.exterior.coords) for part in shapely.get_parts(whole) if part.geom_type == "Polygon"]


def _divided(line: np.ndarray, spacing_m: float) -> np.ndarray:
    """The line with further vertices so that none is farther than `spacing_m` from the next."""
    if len(line) < 2:
        return line
    count = np.maximum(np.ceil(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1) / spacing_m), 1).astype(int)
    segment = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / count[segment]
    inner = line[segment] + share[:, None] * (line[segment + 1] - line[segment])
    return np.vstack([inner, line[-1:]])


def _car_ahead(path: PlanePath, surface: Surface, s_m: float, color: tuple) -> list[Solid]:
    if s_m > path.s_m[-1]:
        return []
    s = np.array([s_m])
    T = surface.stand(path.at(s), path.heading_at(s))[0]
    return car(T[:3, 3], T[:3, :3], color)
