"""A simulated parking garage: slots, pillars, cones, parked cars, one aisle (room: simulation; host).

In: a random generator, the length to drive. Out: World.
"""

from dataclasses import replace

import numpy as np

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import MapElement
from semloc_jax.simulation import elements as make
from semloc_jax.simulation.elements import Painter
from semloc_jax.simulation.paint import GroundArea, wear_pattern
from semloc_jax.simulation.path import PlanePath, path_from_curvature
from semloc_jax.simulation.scene import World
from semloc_jax.simulation.solids import Solid, car, own_body, rotation_about_z
from semloc_jax.simulation.surface import Surface, WaveSurface
from semloc_jax.structs import ElementClass

_AISLE_M = 3.1
"""From the middle of the aisle to the slots."""
_SLOT_M = (2.6, 5.2)
_LINE_M = 0.12
_PILLAR_M = 0.6
_HEIGHT_M = 3.0
_PAST_END_M = 12.0


def build_garage(
    rng: np.random.Generator, length_m: float, wear_share: float, traffic_rng: np.random.Generator | None = None
) -> World:
    """An aisle along x with slots on both sides, which the vehicle drives from x = 0 to x = `length_m`.

    With a `traffic_rng` other cars are parked there, and the line driven is another.
    """
    start, end = -_PAST_END_M, length_m + _PAST_END_M
    straight_s = np.arange(start - 20.0, end + 20.0, 0.05)
    aisle = path_from_curvature(straight_s, np.zeros_like(straight_s), 0.0)
    painter = Painter(aisle, garage_floor(rng))
    columns = np.arange(start, end - _SLOT_M[0], _SLOT_M[0]).tolist()
    occupied = rng.random((2, len(columns))) < 0.5

    elements: list[MapElement] = []
    solids: list[Solid] = []
    for row, side in enumerate((1.0, -1.0)):
        elements += _slots(painter, row, side, columns, occupied[row])
        elements += _pillars(painter, row, side, columns)
        solids += _parked_cars(painter, rng, side, columns, occupied[row])
    elements += _aisle(painter, rng, start, end)
    worn, driven = wear_pattern(wear_share, rng), _driven_path(rng, straight_s)
    if traffic_rng is not None:
        occupied = traffic_rng.random(occupied.shape) < 0.5
        elements = [_slot_now(element, occupied) for element in elements]
        rows = zip((1.0, -1.0), occupied, strict=True)
        solids = [s for side, row in rows for s in _parked_cars(painter, traffic_rng, side, columns, row)]
        driven = _driven_path(traffic_rng, straight_s)

    depth = _AISLE_M + _SLOT_M[1] + 1.5
    floor = np.array([[start - 3.0, -depth], [end + 3.0, -depth], [end + 3.0, depth], [start - 3.0, depth]])
    return World(
        elements=tuple(elements),
        surface=painter.surface,
        areas=(GroundArea(CLASS_IDS["road"], floor),),
        rest=CLASS_IDS["wall"],
        worn=worn,
        path=driven,
        backdrop=CLASS_IDS["wall"],
        ego=(own_body(),),
        parked=tuple(solids),
        along=aisle,
    )


def garage_floor(rng: np.random.Generator) -> Surface:
    """A floor with a little slope and gentle waves."""
    slope = np.array([rng.uniform(-0.01, 0.01), rng.uniform(-0.012, 0.012)])
    wave = 2.0 * np.pi / 25.0 * np.array([[1.0, 0.3]])
    return WaveSurface(slope, np.array([0.02]), wave, rng.uniform(0.0, 2.0 * np.pi, 1))


def _driven_path(rng: np.random.Generator, s_m: np.ndarray) -> PlanePath:
    """A line that sways some decimetres about the middle of the aisle."""
    length_m, sway_m = rng.uniform(18.0, 26.0), rng.uniform(0.2, 0.35)
    wave = 2.0 * np.pi / length_m
    phase = rng.uniform(0.0, 2.0 * np.pi)
    curvature = -sway_m * wave**2 * np.sin(wave * s_m + phase)
    return path_from_curvature(s_m, curvature, float(np.arctan(sway_m * wave * np.cos(phase))))


def _slots(painter: Painter, row: int, side: float, columns: list[float], occupied: np.ndarray) -> list[MapElement]:
    """Painted bars between the slots, and the slots themselves (first two corners: entrance)."""
    near, far = side * _AISLE_M, side * (_AISLE_M + _SLOT_M[1])
    half = 0.5 * _LINE_M
    elements = [
        painter.bar(f"bar_{row}_{k}", "slot_line", ElementClass.SLOT_LINE, (x - half, x + half), (near, far))
        for k, x in enumerate([*columns, columns[-1] + _SLOT_M[0]])
    ]
    for k, x in enumerate(columns):
        corners = np.array([[x, near], [x + _SLOT_M[0], near], [x + _SLOT_M[0], far], [x, far]])
        elements.append(
            MapElement(
                id=f"slot_{row}_{k}",
                label=ElementClass.PARKING_SLOT,
                points=painter.surface.drape(corners),
                closed=True,
                attributes={"class": "parking_slot", "occupied": bool(occupied[k])},
            )
        )
    return elements


def _slot_now(element: MapElement, occupied: np.ndarray) -> MapElement:
    """A slot with the state of another day; other elements as they are."""
    if element.label != ElementClass.PARKING_SLOT:
        return element
    row, number = (int(part) for part in element.id.split("_")[1:])
    return replace(element, attributes={**element.attributes, "occupied": bool(occupied[row, number])})


def _pillars(painter: Painter, row: int, side: float, columns: list[float]) -> list[MapElement]:
    """A pillar behind every third bar."""
    elements = []
    y = side * (_AISLE_M + _SLOT_M[1] + 0.5)
    half = 0.5 * _PILLAR_M
    for k, x in enumerate(columns[1::3]):
        xy = np.array([[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]])
        elements.append(make.pillar(f"pillar_{row}_{k}", painter.surface.drape(xy), _HEIGHT_M))
    return elements


def _aisle(painter: Painter, rng: np.random.Generator, start: float, end: float) -> list[MapElement]:
    """Arrows, a speed bump, a stop line at the end, hanging signs and cones beside the way."""
    elements = [
        painter.arrow(f"arrow_{k}", x, 0.0) for k, x in enumerate(np.arange(start + 5.0, end - 6.0, 11.0).tolist())
    ]
    bump = rng.uniform(9.0, 12.0)
    elements.append(painter.bar("bump_0", "speed_bump", ElementClass.SPEED_BUMP, (bump, bump + 0.34), (-2.85, 2.85)))
    elements.append(painter.bar("stop_0", "stop_line", ElementClass.STOP_LINE, (end - 3.0, end - 2.7), (-2.9, -0.1)))
    for k, x in enumerate(np.arange(start + 8.0, end, 9.0).tolist()):
        base = painter.place(x + rng.uniform(-1.0, 1.0), rng.choice([-1.0, 1.0]) * 2.75)
        elements.append(make.cone(f"cone_{k}", base))
        above = painter.place(x + 4.0, -1.2) + [0.0, 0.0, 2.4]
        elements.append(make.sign(f"sign_{k}", above, np.pi, "circle", 0.5))
    return elements


def _parked_cars(
    painter: Painter, rng: np.random.Generator, side: float, columns: list[float], occupied: np.ndarray
) -> list[Solid]:
    solids: list[Solid] = []
    for x, is_occupied in zip(columns, occupied, strict=True):
        if is_occupied:
            y = side * (_AISLE_M + 0.5 * _SLOT_M[1] + rng.uniform(-0.1, 0.3))
            base = painter.place(x + 0.5 * _SLOT_M[0] + rng.uniform(-0.15, 0.15), y)
            turned = rotation_about_z(0.5 * np.pi * rng.choice([-1.0, 1.0]) + rng.uniform(-0.03, 0.03))
            color = tuple(rng.uniform(0.1, 0.85, 3))
            solids += car(base, turned, color)
    return solids
