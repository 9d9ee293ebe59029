"""A simulated road: four lanes, junctions, lamps, signs, houses, trees and traffic (room: simulation; host).

In: a random generator, the length to drive. Out: World.
"""

from collections.abc import Sequence

import numpy as np

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import MapElement
from semloc_jax.simulation import elements as make
from semloc_jax.simulation.crown import CrownedSurface
from semloc_jax.simulation.elements import Painter
from semloc_jax.simulation.paint import GroundArea, wear_pattern
from semloc_jax.simulation.path import winding_path
from semloc_jax.simulation.scene import World
from semloc_jax.simulation.solids import Solid, car, house, rotation_about_z, tree
from semloc_jax.simulation.surface import rolling_surface
from semloc_jax.structs import ElementClass

LANE_M = 3.5
_BEHIND_M, _AHEAD_M = 40.0, 160.0
_JUNCTION_M = 14.0
"""Length of a junction: stop line, crosswalk, no lane lines."""
_CAR_COLORS = ((0.85, 0.85, 0.85), (0.15, 0.12, 0.1), (0.45, 0.2, 0.12), (0.12, 0.12, 0.5), (0.5, 0.5, 0.48))


def build_road(
    rng: np.random.Generator,
    length_m: float,
    speed_mps: float,
    wear_share: float,
    crown: float = 0.0,
    traffic_rng: np.random.Generator | None = None,
) -> World:
    """A road whose right lane the vehicle drives from s = 0 to s = `length_m`.

    Lateral offsets d are from the middle of that lane: its lines at -1.75 and 1.75, a second lane to 5.25 (double
    centre line), two oncoming lanes to 12.25. With a `crown` the road falls by that share to both sides of its middle.
    Traffic follows from `traffic_rng`, from `rng` unless it is given.
    """
    start, end = -_BEHIND_M, length_m + _AHEAD_M
    path = winding_path(rng, start - 60.0, end + 60.0, start_heading_rad=rng.uniform(-np.pi, np.pi))
    surface = rolling_surface(rng)
    if crown:
        surface = CrownedSurface.along(surface, path, 1.5 * LANE_M, crown, 2.0 * LANE_M + 0.5)
    painter = Painter(path, surface)
    junctions = np.arange(rng.uniform(22.0, 40.0), end - 20.0, rng.uniform(75.0, 95.0)).tolist()

    elements = _lane_lines(painter, start, end, junctions)
    for number, s in enumerate(junctions):
        elements += _junction(painter, number, s)
    elements += _roadside(painter, rng, start, end, junctions)

    areas, worn = _areas(painter, start, end), wear_pattern(wear_share, rng)
    bodies = _surroundings(painter, rng, start, end)
    cars = _plan_traffic(traffic_rng or rng, length_m, speed_mps)

    def traffic(time_s: float) -> Sequence[Solid]:
        return [solid for plan in cars for solid in _car_at(painter, time_s, *plan)]

    rest, sky = CLASS_IDS["terrain"], CLASS_IDS["sky"]
    return World(tuple(elements), surface, tuple(areas), rest, worn, path, sky, tuple(bodies), traffic)


def _lane_lines(painter: Painter, start: float, end: float, junctions: list[float]) -> list[MapElement]:
    """Edge lines, double centre line and dashes, interrupted at junctions."""
    borders = [start, *(edge for s in junctions for edge in (s, s + _JUNCTION_M)), end]
    elements = []
    for part, (begin, stop) in enumerate(zip(borders[::2], borders[1::2], strict=True)):
        for name, d_m, width_m in (
            ("edge_right", -0.5 * LANE_M, 0.15),
            ("center_right", 1.5 * LANE_M - 0.12, 0.12),
            ("center_left", 1.5 * LANE_M + 0.12, 0.12),
            ("edge_left", 3.5 * LANE_M, 0.15),
        ):
            elements.append(painter.line(f"{name}_{part}", "lane_solid", d_m, begin, stop, width_m))
        for name, d_m in (("dash_right", 0.5 * LANE_M), ("dash_left", 2.5 * LANE_M)):
            elements += painter.dashes(f"{name}_{part}", d_m, begin + 3.0, stop - 1.0, 4.0, 6.0)
    return elements


def _junction(painter: Painter, number: int, s: float) -> list[MapElement]:
    """Stop line, crosswalk, arrows and traffic lights of one junction."""
    right, left = -0.5 * LANE_M, 3.5 * LANE_M
    elements = [
        painter.bar(f"stop_{number}", "stop_line", ElementClass.STOP_LINE, (s, s + 0.4), (right + 0.2, 1.5 * LANE_M))
    ]
    for bar, d in enumerate(np.arange(right + 0.3, left - 0.6, 1.0).tolist()):
        name = f"crosswalk_{number}_{bar}"
        elements.append(painter.bar(name, "crosswalk", ElementClass.CROSSWALK, (s + 2.0, s + 5.0), (d, d + 0.5)))
    for lane, d in enumerate((0.0, LANE_M)):
        elements.append(painter.arrow(f"arrow_{number}_{lane}", s - 9.0, d))
    for side, d in (("right", right - 1.0), ("left", left + 1.0)):
        base = painter.place(s + 1.0, d)
        elements.append(make.pole(f"signal_post_{number}_{side}", base, 3.4, 0.07, 0.07, "signal_post"))
        elements.append(make.traffic_light(f"light_{number}_{side}", base + [0.0, 0.0, 2.3]))
    return elements


def _roadside(
    painter: Painter, rng: np.random.Generator, start: float, end: float, junctions: list[float]
) -> list[MapElement]:
    """Lamp posts on both sides, signs on posts on the right."""
    elements = []
    for side, d, offset in (("right", -0.5 * LANE_M - 1.6, 0.0), ("left", 3.5 * LANE_M + 1.6, 14.0)):
        for number, s in enumerate(np.arange(start + offset, end, 28.0) + rng.uniform(-3.0, 3.0)):
            base = painter.place(float(s), d)
            elements.append(make.pole(f"lamp_{side}_{number}", base, 8.0, 0.095, 0.065, "lamp_post"))
    for number, s in enumerate(np.arange(start + 20.0, end, 24.0) + rng.uniform(-6.0, 6.0)):
        if any(junction - 2.0 < s < junction + _JUNCTION_M for junction in junctions):
            continue
        base = painter.place(float(s), -0.5 * LANE_M - 1.1)
        facing = painter.heading(float(s)) + np.pi + rng.uniform(-0.1, 0.1)
        center = base + [0.05 * np.cos(facing), 0.05 * np.sin(facing), rng.uniform(2.1, 2.5)]
        shape = str(rng.choice(["circle", "triangle", "rectangle"]))
        height_m = float(center[2] - base[2]) + 0.4
        elements.append(make.pole(f"sign_post_{number}", base, height_m, 0.035, 0.035, "sign_post"))
        elements.append(make.sign(f"sign_{number}", center, facing, shape, rng.uniform(0.6, 0.9)))
    return elements


def _areas(painter: Painter, start: float, end: float) -> list[GroundArea]:
    s = np.arange(start - 50.0, end + 50.0, 1.0)
    areas = []
    for name, right, left in (
        ("sidewalk", -0.5 * LANE_M - 4.0, 3.5 * LANE_M + 4.0),
        ("road", -0.5 * LANE_M - 0.5, 3.5 * LANE_M + 0.5),
    ):
        outline = np.vstack([painter.path.at(s, right), painter.path.at(s, left)[::-1]])
        areas.append(GroundArea(CLASS_IDS[name], outline))
    return areas


def _surroundings(painter: Painter, rng: np.random.Generator, start: float, end: float) -> list[Solid]:
    """Houses and trees on both sides, beyond the sidewalks."""
    solids: list[Solid] = []
    for side, d in ((-1.0, -0.5 * LANE_M), (1.0, 3.5 * LANE_M)):
        for s in np.arange(start, end + 40.0, 26.0) + rng.uniform(-4.0, 4.0):
            depth, width, height = rng.uniform(8.0, 14.0), rng.uniform(12.0, 20.0), rng.uniform(6.0, 18.0)
            base = painter.place(float(s), d + side * (9.0 + 0.5 * depth))
            wall = rotation_about_z(painter.heading(float(s)))
            solids.append(house(base, wall, (width, depth, height), rng.uniform(0.35, 0.75)))
        for s in np.arange(start, end, 33.0) + rng.uniform(-8.0, 8.0):
            base = painter.place(float(s), d + side * 5.5)
            solids += tree(base, rng.uniform(1.3, 2.0), 2.6)
    return solids


def _plan_traffic(rng: np.random.Generator, length_m: float, speed_mps: float) -> list[tuple]:
    """Start s, speed along s, lateral offset and colour of each car."""
    cars = [(rng.uniform(22.0, 35.0), speed_mps, 0.0), (rng.uniform(8.0, 18.0), 1.1 * speed_mps, LANE_M)]
    for lane in (2.0, 3.0):
        gap = rng.uniform(25.0, 60.0)
        cars += [(s, -speed_mps, lane * LANE_M) for s in np.arange(gap, 2.0 * length_m + _AHEAD_M, 45.0).tolist()]
    return [(*plan, _CAR_COLORS[int(rng.integers(len(_CAR_COLORS)))]) for plan in cars]


def _car_at(painter: Painter, time_s: float, start_m: float, speed_mps: float, d_m: float, color: tuple) -> list[Solid]:
    s = start_m + speed_mps * time_s
    if not painter.path.s_m[0] < s < painter.path.s_m[-1]:
        return []
    base = painter.place(s, d_m)
    T = painter.surface.stand(base[None, :2], np.array([painter.heading(s)]))[0]
    return car(base, T[:3, :3], color)
