"""An intersection of a closed road with a side street (room: simulation; host).

In: where it is, what it looks like. Out: its map elements, the ground and the houses' line of its arms.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import MapElement
from semloc_jax.simulation import elements as make
from semloc_jax.simulation.elements import Painter
from semloc_jax.simulation.paint import GroundArea
from semloc_jax.simulation.path import PlanePath, path_from_curvature
from semloc_jax.structs import ElementClass

LANE_M = 3.25
ARM_M = 42.0
"""From the middle of the road to the end of what is built of a side street."""
_CORNER_M = 2.5
_APPROACH_M = 5.3
"""From the open middle to the stop line: a crosswalk and room for it."""
_BAR_M, _BAR_STEP_M = 0.5, 1.0


@dataclass(frozen=True)
class IntersectionLook:
    """What distinguishes one intersection from another; twins share it.

    Args:
        arms: sides with a street, 1 left and -1 right of the direction of travel.
        crosswalks: where there are some: before and behind along the road, and on the arms.
        has_lights: whether traffic lights stand at it, else signs.
        sign_shapes: of the signs at its entries.
        arrow_m: distance of the arrows from the stop lines.
    """

    arms: tuple[int, ...]
    crosswalks: tuple[bool, bool, bool]
    has_lights: bool
    sign_shapes: tuple[str, str]
    arrow_m: float


@dataclass(frozen=True)
class Intersection:
    """A place on the road where a street crosses.

    Args:
        tag: its name.
        s_m: its middle along the road.
        num_lanes: lanes of the road for each direction.
        look: what it looks like.
        is_twin: whether another one looks the same.
    """

    tag: str
    s_m: float
    num_lanes: int
    look: IntersectionLook
    is_twin: bool

    @property
    def half_road_m(self) -> float:
        """Half the width of the road here."""
        return self.num_lanes * LANE_M

    @property
    def open_m(self) -> tuple[float, float]:
        """Where the lines of the road end and begin again: at the stop lines."""
        half_m = LANE_M + _CORNER_M + _APPROACH_M
        return self.s_m - half_m, self.s_m + half_m


def random_look(rng: np.random.Generator, is_main: bool) -> IntersectionLook:
    """A seeded look: a crossing with lights on the main straight, else a crossing or a junction of any kind."""
    arms = (1, -1) if is_main or rng.random() < 0.5 else (int(rng.choice([-1, 1])),)
    crosswalks = (True, True, True) if is_main else tuple(bool(v) for v in rng.random(3) < 0.65)
    shapes = tuple(str(shape) for shape in rng.choice(["circle", "triangle", "rectangle"], 2))
    return IntersectionLook(arms, crosswalks, is_main, shapes, float(rng.uniform(9.0, 14.0)))


def intersection_elements(painter: Painter, place: Intersection) -> list[MapElement]:
    """All that is painted or stands at an intersection; what is on the road first."""
    look, tag = place.look, place.tag
    first, last = place.open_m
    half_m = place.half_road_m
    elements = [
        painter.bar(f"stop_{tag}f", "stop_line", ElementClass.STOP_LINE, (first, first + 0.4), (-half_m + 0.2, -0.2)),
        painter.bar(f"stop_{tag}b", "stop_line", ElementClass.STOP_LINE, (last - 0.4, last), (0.2, half_m - 0.2)),
    ]
    for side, (begin, wanted) in enumerate(zip((first + 1.2, last - 4.2), look.crosswalks[:2], strict=True)):
        if wanted:
            elements += _crosswalk(painter, f"crosswalk_{tag}{'ab'[side]}", begin, half_m)
    for lane in range(place.num_lanes):
        d = (lane + 0.5) * LANE_M
        elements.append(painter.arrow(f"arrow_{tag}f{lane}", first - look.arrow_m, -d))
        elements.append(painter.arrow(f"arrow_{tag}b{lane}", last + look.arrow_m, d, is_forward=False))
    for k, (s, d, facing) in enumerate(((first + 0.2, -half_m - 1.0, np.pi), (last - 0.2, half_m + 1.0, 0.0))):
        elements += _posts(painter, place, k, s, d, facing)
    for side in look.arms:
        elements += _arm(arm_painter(painter, place, side), place, side)
    return elements


def arm_painter(painter: Painter, place: Intersection, side: int) -> Painter:
    """Draws along a side street: s from the middle of the road outwards, d to the left of that direction."""
    return Painter(_arm_path(painter.path, place, side), painter.surface)


def _arm_path(road: PlanePath, place: Intersection, side: int) -> PlanePath:
    s = np.arange(-1.0, ARM_M + 2.0, 0.1)
    heading = float(road.heading_at(np.array([place.s_m]))[0]) + 0.5 * np.pi * side
    straight = path_from_curvature(s, np.zeros_like(s), heading)
    return PlanePath(s, straight.xy + road.at(np.array([place.s_m]))[0], straight.heading_rad)


def _crosswalk(painter: Painter, name: str, begin_m: float, half_m: float) -> list[MapElement]:
    """Bars along the way of traffic, side by side across the whole street."""
    starts = np.arange(-half_m + 0.3, half_m - _BAR_M, _BAR_STEP_M).tolist()
    bars = [
        painter.bar(f"{name}_{k}", "crosswalk", ElementClass.CROSSWALK, (begin_m, begin_m + 3.0), (d, d + _BAR_M))
        for k, d in enumerate(starts)
    ]
    return [make.with_attributes(bar, group=name) for bar in bars]


def _posts(painter: Painter, place: Intersection, k: int, s: float, d: float, facing: float) -> list[MapElement]:
    """A light or a sign at an entry, its face towards those who come."""
    tag, base = place.tag, painter.place(s, d)
    if place.look.has_lights:
        return [
            make.pole(f"mast_{tag}{k}", base, 3.6, 0.09, 0.08, "signal_mast"),
            make.traffic_light(f"tl_{tag}{k}", base + [0.0, 0.0, 2.4]),
            *_hanging_sign(painter, place, k, s, d, facing),
        ]
    return [
        make.pole(f"signpost_{tag}{k}", base, 2.9, 0.035, 0.035, "sign_post"),
        *_hanging_sign(painter, place, k, s, d, facing),
    ]


def _hanging_sign(painter: Painter, place: Intersection, k: int, s: float, d: float, facing: float) -> list[MapElement]:
    toward = painter.heading(s) + facing
    offset = np.array([0.06 * np.cos(toward), 0.06 * np.sin(toward), 1.9 if place.look.has_lights else 2.4])
    return [make.sign(f"sign_{place.tag}{k}", painter.place(s, d) + offset, toward, place.look.sign_shapes[k], 0.7)]


def _arm(painter: Painter, place: Intersection, side: int) -> list[MapElement]:
    """Stop line, crosswalk and lines of a side street."""
    name, half_m = f"{place.tag}{'r' if side < 0 else 'l'}", place.half_road_m
    stop = half_m + _CORNER_M + _APPROACH_M
    elements = [
        painter.bar(f"stop_{name}", "stop_line", ElementClass.STOP_LINE, (stop - 0.4, stop), (0.2, LANE_M - 0.2)),
        painter.line(f"side_solid_{name}", "lane_solid", 0.0, stop, stop + 9.0, 0.12),
        *painter.dashes(f"side_{name}", 0.0, stop + 12.0, ARM_M, 3.0, 6.0),
    ]
    if place.look.crosswalks[2]:
        elements += _crosswalk(painter, f"crosswalk_{name}", stop - 4.2, LANE_M)
    return elements


def intersection_areas(painter: Painter, place: Intersection) -> list[GroundArea]:
    """The open middle with its corners and the side streets, as road."""
    road, half_m = CLASS_IDS["road"], place.half_road_m
    across_m = LANE_M + _CORNER_M
    outlines = [_rectangle(painter, (place.s_m - across_m, place.s_m + across_m), half_m + _CORNER_M)]
    for side in place.look.arms:
        outlines.append(_rectangle(arm_painter(painter, place, side), (0.0, ARM_M), LANE_M + 0.4))
    return [GroundArea(road, outline) for outline in outlines]


def arm_shapes(painter: Painter, place: Intersection, wide_m: float) -> list[shapely.Polygon]:
    """The side streets from above with `wide_m` to each side of their middle."""
    arms = [arm_painter(painter, place, side) for side in place.look.arms]
    return [shapely.Polygon(_rectangle(arm, (0.0, ARM_M + 1.0), wide_m)) for arm in arms]


def _rectangle(painter: Painter, s_range: tuple[float, float], half_m: float) -> Float[np.ndarray, "4 2"]:
    s, d = np.array(s_range)[[0, 1, 1, 0]], half_m * np.array([-1.0, -1.0, 1.0, 1.0])
    return painter.path.at(s, d)
