"""A closed town road with look-alike intersections and one or two lanes a direction (room: simulation; host).

In: a random generator. Out: LoopPlan (geometry), and the World built on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Float

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import MapElement
from semloc_jax.simulation import elements as make
from semloc_jax.simulation.elements import Painter
from semloc_jax.simulation.intersection import (
    LANE_M,
    Intersection,
    arm_shapes,
    intersection_areas,
    intersection_elements,
    random_look,
)
from semloc_jax.simulation.paint import GroundArea, wear_pattern
from semloc_jax.simulation.path import ClosedLine, closed_line
from semloc_jax.simulation.scene import World
from semloc_jax.simulation.solids import Solid, house, rotation_about_z, tree
from semloc_jax.simulation.surface import rolling_surface

_TAPER_M = 35.0
"""Over this length the road widens from one lane to two."""
_WIDE_M = 62.0
"""The road has two lanes from so far before the first twin to so far behind the second."""
_SIDEWALK_M, _SHOULDER_M = 3.4, 0.4
_PIECE_M = 70.0
"""Longest piece of a solid line."""
_DASH_M, _GAP_M = 3.0, 6.0
_APART_M = 95.0
"""Other intersections keep this far from one another."""
_GENTLE_PER_M = 0.003


@dataclass(frozen=True)
class LoopPlan:
    """The plan of a closed road.

    Args:
        line: middle of the road.
        intersections: in the order of travel, twins among them.
        wide_m: where the road has two lanes a direction.
        start_m: where drives begin and end.
    """

    line: ClosedLine
    intersections: tuple[Intersection, ...]
    wide_m: tuple[float, float]
    start_m: float

    def half_width(self, s_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """From the middle to the edge lines [m]."""
        s = np.mod(s_m, self.line.length_m)
        first, last = self.wide_m
        inside = np.minimum((s - first) / _TAPER_M, (last - s) / _TAPER_M)
        share = np.clip(inside + 1.0, 0.0, 1.0)
        return LANE_M * (1.0 + share * share * (3.0 - 2.0 * share))


def plan_loop(rng: np.random.Generator) -> LoopPlan:
    """A seeded closed road: two twins on its longest straight, others where it is nearly straight."""
    apart_m = float(rng.uniform(105.0, 140.0))
    line = closed_line(rng, apart_m + 95.0)
    begin, end = line.straight_m
    first = float(rng.uniform(begin + 45.0, end - apart_m - 45.0))
    main = random_look(rng, is_main=True)
    places = [Intersection(tag, first + k * apart_m, 2, main, True) for k, tag in enumerate("AB")]
    wide = (first - _WIDE_M, first + apart_m + _WIDE_M)
    straight = np.abs(line.curvature) < _GENTLE_PER_M
    s = np.linspace(0.0, line.length_m, len(line.xy), endpoint=False)
    for tag in "CDE"[: int(rng.integers(2, 4))]:
        free = [
            at
            for at in s[::20].tolist()
            if _is_straight(straight, at / line.length_m) and _is_apart(at, places, wide, line.length_m)
        ]
        if free:
            at = float(rng.choice(free))
            places.append(Intersection(tag, at, 1, random_look(rng, is_main=False), False))
    places.sort(key=lambda place: place.s_m)
    return LoopPlan(line, tuple(places), wide, _start(places, wide, line.length_m))


def _is_straight(straight: np.ndarray, share: float) -> bool:
    reach = 220
    around = np.arange(-reach, reach) + round(share * len(straight))
    return bool(straight[around % len(straight)].all())


def _is_apart(s: float, places: Sequence[Intersection], wide: tuple[float, float], length_m: float) -> bool:
    if wide[0] - _TAPER_M - 40.0 < s < wide[1] + _TAPER_M + 40.0:
        return False
    away = [abs(s - place.s_m) for place in places]
    return all(min(d, length_m - d) > _APART_M for d in away) and 30.0 < s < length_m - 30.0


def _start(places: Sequence[Intersection], wide: tuple[float, float], length_m: float) -> float:
    """A place with one lane a direction, as far as possible from every intersection."""
    s = np.arange(0.0, length_m, 5.0)
    away = np.min([np.abs(s - place.s_m) for place in places], axis=0)
    away[(s > wide[0] - _TAPER_M - 20.0) & (s < wide[1] + _TAPER_M + 20.0)] = 0.0
    away[(s < 10.0) | (s > length_m - 10.0)] = 0.0
    return float(s[np.argmax(away)])


def build_loop(plan: LoopPlan, rng: np.random.Generator, wear_share: float) -> World:
    """The world of a plan, without traffic."""
    surface = rolling_surface(rng, camber=0.012)
    length_m = plan.line.length_m
    # The stretch that goes on into the next lap is drawn as one.
    road = plan.line.unrolled(-120.0, 2.0 * length_m)
    painter = Painter(road, surface)
    elements = _lane_lines(painter, plan)
    for place in plan.intersections:
        elements += intersection_elements(painter, place)
    elements += _roadside(painter, plan, rng)
    areas = _areas(painter, plan)
    worn = wear_pattern(wear_share, rng)
    bodies = _surroundings(painter, plan, rng)
    rest, sky = CLASS_IDS["terrain"], CLASS_IDS["sky"]
    return World(tuple(elements), surface, tuple(areas), rest, worn, road, sky, tuple(bodies))


def _stretches(plan: LoopPlan) -> list[tuple[str, float, float]]:
    """Where lines run from one intersection to the next; the last one goes on into the next lap."""
    following = (*plan.intersections[1:], plan.intersections[0])
    stretches = []
    for one, other in zip(plan.intersections, following, strict=True):
        lap_m = 0.0 if other.s_m > one.s_m else plan.line.length_m
        stretches.append((f"{one.tag}{other.tag}", one.open_m[1], other.open_m[0] + lap_m))
    return stretches


def _lane_lines(painter: Painter, plan: LoopPlan) -> list[MapElement]:
    """Edge lines, the middle line and the lines between lanes."""
    elements = []
    for name, begin, end in _stretches(plan):
        pieces = np.linspace(begin, end, max(2, round((end - begin) / _PIECE_M) + 1))
        for k, (first, last) in enumerate(zip(pieces[:-1].tolist(), pieces[1:].tolist(), strict=True)):
            for side, sign in (("R", -1.0), ("L", 1.0)):
                elements.append(
                    painter.curve(
                        f"edge_{name}{side}_{k}",
                        "lane_solid",
                        lambda s, sign=sign: sign * plan.half_width(s),
                        first,
                        last,
                        0.15,
                        group=f"edge_{name}{side}",
                    )
                )
        for kind, first, last in _runs(plan, begin, end):
            elements += _wide_lines(painter, name, first, last) if kind else _narrow_lines(painter, name, first, last)
    return elements


def _runs(plan: LoopPlan, begin: float, end: float) -> list[tuple[bool, float, float]]:
    """The parts of a stretch with one lane (False) and with two (True) a direction, tapers among the former."""
    length_m = plan.line.length_m
    cuts = [cut + lap for cut in plan.wide_m for lap in (0.0, length_m)]
    borders = [begin, *sorted(cut for cut in cuts if begin < cut < end), end]
    parts = []
    for first, last in pairwise(borders):
        middle = (0.5 * (first + last)) % length_m
        parts.append((plan.wide_m[0] < middle < plan.wide_m[1], first, last))
    return parts


def _wide_lines(painter: Painter, name: str, first: float, last: float) -> list[MapElement]:
    """Two lanes a direction: a double middle line, dashes between lanes, solid near the ends."""
    elements = [
        painter.line(f"center_{name}{side}", "lane_solid", d, first, last, 0.12, group=f"center_{name}", color="yellow")
        for side, d in (("R", -0.12), ("L", 0.12))
    ]
    solid_m = min(12.0, 0.25 * (last - first))
    for side, d in (("R", -LANE_M), ("L", LANE_M)):
        line = f"lane_{name}{side}"
        elements.append(painter.line(f"{line}_solid_a", "lane_solid", d, first, first + solid_m, 0.15))
        elements.append(painter.line(f"{line}_solid_b", "lane_solid", d, last - solid_m, last, 0.15))
        elements += painter.dashes(line, d, first + solid_m + _GAP_M, last - solid_m - 2.0, _DASH_M, _GAP_M)
    return elements


def _narrow_lines(painter: Painter, name: str, first: float, last: float) -> list[MapElement]:
    """One lane a direction: dashes in the middle, solid towards the ends, and the line that they mean."""
    line, solid_m = f"cl_{name}_{round(first)}", min(15.0, 0.2 * (last - first))
    return [
        painter.line(f"{line}_a", "lane_solid", 0.0, first, first + solid_m, 0.12, group=line),
        painter.line(f"{line}_b", "lane_solid", 0.0, last - solid_m, last, 0.12, group=line),
        *painter.dashes(line, 0.0, first + solid_m + _GAP_M, last - solid_m - 2.0, _DASH_M, _GAP_M),
        painter.curve(line, "lane_boundary", np.zeros_like, first, last, 0.12, note="logical line, not painted itself"),
    ]


def _roadside(painter: Painter, plan: LoopPlan, rng: np.random.Generator) -> list[MapElement]:
    """Lamps and signs beside the road; around the twins they stand at the same places, too."""
    elements: list[MapElement] = []
    gap_m = float(rng.uniform(24.0, 34.0))
    shapes = rng.choice(["circle", "triangle", "rectangle"], 40)
    for name, begin, end in _stretches(plan):
        is_between_twins = name == "AB"
        for side, sign in (("R", -1.0), ("L", 1.0)):
            first = begin + (4.0 if side == "R" else 15.0)
            places = np.arange(first, end - 3.0, gap_m)
            spread = 0.0 if is_between_twins else 4.0
            for k, s in enumerate((places + rng.uniform(-spread, spread, len(places))).tolist()):
                edge = float(plan.half_width(np.array([s]))[0])
                base = painter.place(s, sign * (edge + 1.5))
                elements.append(make.pole(f"lamp_{name}{side}_{k}", base, 8.2, 0.095, 0.065, "lamp_post"))
        for k, s in enumerate(np.arange(begin + 22.0, end - 12.0, float(rng.uniform(32.0, 45.0))).tolist()):
            side = 1.0 if k % 3 == 2 else -1.0
            elements += _sign(painter, plan, f"{name}{k}", s, side, str(shapes[len(elements) % 40]), rng)
    return elements


def _sign(
    painter: Painter, plan: LoopPlan, name: str, s: float, side: float, shape: str, rng: np.random.Generator
) -> list[MapElement]:
    """A sign on a post: for the own direction on the right, for the other one on the left."""
    edge = float(plan.half_width(np.array([s]))[0])
    base = painter.place(s, side * (edge + 0.9))
    facing = painter.heading(s) + (np.pi if side < 0 else 0.0) + float(rng.uniform(-0.08, 0.08))
    center = base + [0.05 * np.cos(facing), 0.05 * np.sin(facing), float(rng.uniform(2.1, 2.6))]
    height_m = float(center[2] - base[2]) + 0.4
    return [
        make.pole(f"signpost_{name}", base, height_m, 0.035, 0.035, "sign_post"),
        make.sign(f"sign_{name}", center, facing, shape, float(rng.uniform(0.6, 0.85))),
    ]


def _areas(painter: Painter, plan: LoopPlan) -> list[GroundArea]:
    """Sidewalks, and the road over them, in pieces that overlap a little."""
    length_m = plan.line.length_m
    borders = np.linspace(0.0, length_m, 13)
    areas = []
    for name, beyond_m in (("sidewalk", _SIDEWALK_M), ("road", _SHOULDER_M)):
        for first, last in pairwise(borders):
            s = np.arange(first - 0.5, last + 1.0, 0.5)
            wide = plan.half_width(s) + beyond_m
            outline = np.vstack([painter.path.at(s, -wide), painter.path.at(s, wide)[::-1]])
            areas.append(GroundArea(CLASS_IDS[name], outline))
    for place in plan.intersections:
        areas += intersection_areas(painter, place)
    return areas


def _surroundings(painter: Painter, plan: LoopPlan, rng: np.random.Generator) -> list[Solid]:
    """Houses and trees beside the road, none on any street."""
    s = np.arange(0.0, plan.line.length_m, 2.0)
    wide = plan.half_width(s) + _SIDEWALK_M + 0.6
    ring = shapely.union_all([shapely.Point(xy).buffer(w) for xy, w in zip(painter.path.at(s), wide, strict=True)])
    arms = [arm_shapes(painter, place, LANE_M + 1.5) for place in plan.intersections]
    streets = shapely.union_all([ring, *(shape for shapes in arms for shape in shapes)])
    shapely.prepare(streets)
    solids: list[Solid] = []
    for side in (-1.0, 1.0):
        for at in np.arange(0.0, plan.line.length_m, float(rng.uniform(22.0, 30.0))).tolist():
            solids += _house(painter, plan, at, side, streets, rng)
        for at in np.arange(8.0, plan.line.length_m, float(rng.uniform(26.0, 40.0))).tolist():
            solids += _tree(painter, plan, at + float(rng.uniform(-6.0, 6.0)), side, streets, rng)
    return solids


def _house(
    painter: Painter, plan: LoopPlan, s: float, side: float, streets: shapely.Geometry, rng: np.random.Generator
) -> list[Solid]:
    depth, width, height = rng.uniform(8.0, 13.0), rng.uniform(11.0, 19.0), rng.uniform(5.0, 16.0)
    beyond_m, shade, exists = rng.uniform(5.5, 10.0), rng.uniform(0.35, 0.75), rng.random() < 0.8
    d = float(side * (plan.half_width(np.array([s]))[0] + beyond_m + 0.5 * depth))
    base, turned = painter.place(s, d), rotation_about_z(painter.heading(s))
    corners = 0.5 * np.array([[-width, -depth], [width, -depth], [width, depth], [-width, depth]])
    corners = base[:2] + corners @ turned[:2, :2].T
    if not exists or streets.intersects(shapely.Polygon(corners)):
        return []
    return [house(base, turned, (float(width), float(depth), float(height)), shade)]


def _tree(
    painter: Painter, plan: LoopPlan, s: float, side: float, streets: shapely.Geometry, rng: np.random.Generator
) -> list[Solid]:
    crown = float(rng.uniform(1.3, 2.0))
    d = float(side * (plan.half_width(np.array([s]))[0] + _SIDEWALK_M + 1.2))
    base = painter.place(s, d)
    if streets.intersects(shapely.Point(base[:2]).buffer(0.3)):
        return []
    return tree(base, crown, 3.0)
