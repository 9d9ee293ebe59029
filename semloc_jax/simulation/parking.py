"""A garage with rings of aisles, or an open lot, built on a plan (room: simulation; host).

In: a ParkingPlan, a random generator. Out: World without cars; the cars of a drive.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import MapElement
from semloc_jax.simulation import elements as make
from semloc_jax.simulation.elements import Painter
from semloc_jax.simulation.garage import garage_floor
from semloc_jax.simulation.paint import GroundArea, wear_pattern
from semloc_jax.simulation.parking_drive import LANE_M
from semloc_jax.simulation.parking_plan import ParkingPlan
from semloc_jax.simulation.path import PlanePath, path_from_curvature
from semloc_jax.simulation.scene import World
from semloc_jax.simulation.slot_rows import SlotRow, number_box, number_paint, row_elements, slot_number
from semloc_jax.simulation.solids import Solid, car, own_body, rotation_about_z
from semloc_jax.simulation.surface import Surface
from semloc_jax.structs import ElementClass

_PILLAR_M, _HEIGHT_M = 0.55, 3.0
_ARROW_M = 2.5
"""Half the length of an arrow."""
_BUMP_M = 0.34
_EDGE_M = 0.3


def build_hall(plan: ParkingPlan, rng: np.random.Generator, wear_share: float) -> World:
    """A garage: pillars, numbered slots, hanging signs; walls all around."""
    painter = square_painter(plan, garage_floor(rng))
    elements = [e for row in plan.rows for e in row_elements(row, painter.surface, has_back(row), _is_numbered(row))]
    for kind in (aisle_marks, cross_marks, _hanging_signs, cones_beside):
        elements += kind(painter, plan, rng)
    elements += _pillars(painter, plan)
    numbered = [(row, slot) for row in plan.rows if _is_numbered(row) for slot in range(row.count)]
    paint, wall = CLASS_IDS["arrow"], CLASS_IDS["wall"]
    return World(
        elements=tuple(elements),
        surface=painter.surface,
        areas=(GroundArea(CLASS_IDS["road"], floor_outline(plan, 0.0)),),
        rest=wall,
        worn=wear_pattern(wear_share, rng),
        path=painter.path,
        backdrop=wall,
        ego=(own_body(),),
        glyphs=tuple((number_paint(row, slot), paint) for row, slot in numbered),
        features=tuple(_number_feature(painter, row, slot) for row, slot in numbered),
    )


def with_cars(world: World, plan: ParkingPlan, free: Collection[str], share: float, rng: np.random.Generator) -> World:
    """The world on one day: a share of the slots is taken, none of those that are to stay free."""
    parked: list[Solid] = []
    taken = set()
    for row in plan.rows:
        for slot in range(row.count):
            is_taken, car_now = rng.random() < share, _parked_car(world, row, slot, rng)
            if is_taken and row.slot_id(slot) not in free:
                parked += car_now
                taken.add(row.slot_id(slot))
    elements = [
        make.with_attributes(e, occupied=e.id in taken) if e.label == ElementClass.PARKING_SLOT else e
        for e in world.elements
    ]
    return replace(world, elements=tuple(elements), parked=tuple(parked))


def _parked_car(world: World, row: SlotRow, slot: int, rng: np.random.Generator) -> list[Solid]:
    """A car in a slot, nose in or out, not quite straight."""
    a, b = row.pitch_m * (slot + 0.5) + rng.uniform(-0.12, 0.12), row.depth_m * 0.5 + rng.uniform(-0.12, 0.08)
    base = world.surface.drape(row.at(np.array([a]), np.array([b])))[0]
    yaw = row.heading_in() + np.pi * rng.integers(2) + rng.uniform(-0.03, 0.03)
    return car(base, rotation_about_z(float(yaw)), tuple(rng.uniform(0.1, 0.85, 3)))


def square_painter(plan: ParkingPlan, surface: Surface) -> Painter:
    """Draws in the axes of the plan: s is x and d is y."""
    s = np.arange(plan.low_xy[0] - 40.0, plan.high_xy[0] + 40.0, 0.25)
    return Painter(path_from_curvature(s, np.zeros_like(s), 0.0), surface)


def upright_painter(painter: Painter, x_m: float) -> Painter:
    """Draws along an aisle along y: s is y, d is to its left."""
    y = painter.path.s_m
    line = np.column_stack([np.full_like(y, x_m), y])
    return Painter(PlanePath(y, line, np.full_like(y, 0.5 * np.pi)), painter.surface)


def has_back(row: SlotRow) -> bool:
    """One row of a pair paints the line at the back of both; a row at the wall its own."""
    return row.kind != "perp" or row.side > 0


def _is_numbered(row: SlotRow) -> bool:
    return row.kind == "perp" and len(row.name) == 1


def floor_outline(plan: ParkingPlan, beyond_m: float) -> np.ndarray:
    """Corners of the floor, or of a strip around it."""
    x0, y0 = np.array(plan.low_xy) - beyond_m
    x1, y1 = np.array(plan.high_xy) + beyond_m
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def aisle_marks(painter: Painter, plan: ParkingPlan, rng: np.random.Generator) -> list[MapElement]:
    """Arrows in both lanes of the aisles along x, bumps across some, stop lines before some crossings."""
    elements = []
    reach = 0.5 * plan.aisle_m - _EDGE_M
    for k, y in enumerate(plan.y_m):
        for block, (begin, end) in enumerate(plan.blocks()):
            name, bump = f"{k}{block}", float(rng.uniform(0.4, 0.6) * (end - begin) + begin)
            has_bump = rng.random() < 0.6
            if has_bump:
                across = (y - reach, y + reach)
                span = (bump, bump + _BUMP_M)
                elements.append(painter.bar(f"bump_{name}", "speed_bump", ElementClass.SPEED_BUMP, span, across))
            step_m = float(rng.uniform(10.0, 14.0))
            for lane, sign in (("e", -1.0), ("w", 1.0)):
                places = np.arange(begin + 4.0 + rng.uniform(0.0, 2.0), end - 3.5, step_m)
                for number, x in enumerate(places.tolist()):
                    if not has_bump or abs(x - bump) > _ARROW_M + 1.0:
                        arrow = f"arrow_{name}{lane}{number}"
                        elements.append(painter.arrow(arrow, x, y + sign * LANE_M, is_forward=sign < 0))
                if rng.random() < 0.6:
                    span = (end, end + 0.3) if sign < 0 else (begin - 0.3, begin)
                    across = tuple(sorted((y + sign * 0.15, y + sign * reach)))
                    elements.append(
                        painter.bar(f"stop_{name}{lane}", "stop_line", ElementClass.STOP_LINE, span, across)
                    )
    return elements


def cross_marks(painter: Painter, plan: ParkingPlan, rng: np.random.Generator) -> list[MapElement]:
    """Arrows in both lanes of the aisles along y, between the aisles along x."""
    elements = []
    for j, x in enumerate(plan.x_m):
        upright = upright_painter(painter, x)
        for k, (low, high) in enumerate(zip(plan.y_m[:-1], plan.y_m[1:], strict=True)):
            middle = 0.5 * (low + high) + float(rng.uniform(-1.0, 1.0))
            elements.append(upright.arrow(f"arrow_up{j}{k}", middle, -LANE_M))
            elements.append(upright.arrow(f"arrow_down{j}{k}", middle, LANE_M, is_forward=False))
    return elements


def _hanging_signs(painter: Painter, plan: ParkingPlan, rng: np.random.Generator) -> list[MapElement]:
    """Signs over the lanes at the ends of islands, facing who comes."""
    elements = []
    for k, y in enumerate(plan.y_m):
        for block, (begin, end) in enumerate(plan.blocks()):
            for lane, x, sign, facing in (("e", begin + 1.0, -1.0, np.pi), ("w", end - 1.0, 1.0, 0.0)):
                shape, height_m = str(rng.choice(["circle", "rectangle"])), float(rng.uniform(2.2, 2.45))
                if rng.random() < 0.7:
                    center = painter.place(x, y + sign * LANE_M) + [0.0, 0.0, height_m]
                    elements.append(make.sign(f"sign_{k}{block}{lane}", center, facing, shape, 0.5))
    return elements


def cones_beside(painter: Painter, plan: ParkingPlan, rng: np.random.Generator) -> list[MapElement]:
    """Cones at the ends of islands, beside the way."""
    ends = [(x, y) for begin, end, y in plan.backs for x in (begin - 0.55, end + 0.55)]
    places = [(x, y + float(rng.uniform(-3.0, 3.0))) for x, y in ends if rng.random() < 0.5]
    return [make.cone(f"cone_{k}", painter.place(x, y)) for k, (x, y) in enumerate(places)]


def _pillars(painter: Painter, plan: ParkingPlan) -> list[MapElement]:
    """Pillars behind every third bar: between the rows of an island, and behind the rows at the walls."""
    feet = []
    for row in plan.rows:
        is_outer = not any(abs(row.at(np.zeros(1), np.array([row.depth_m]))[0, 1] - y) < 0.1 for _, _, y in plan.backs)
        if row.side < 0 and not is_outer:
            continue
        a = row.pitch_m * np.arange(0, row.count + 1, 3 if row.kind != "par" else 2)
        feet.append(row.at(a, np.full(len(a), row.depth_m + (0.6 if is_outer else 0.0))))
    half = 0.5 * _PILLAR_M * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return [
        make.pillar(f"pillar_{k}", painter.surface.drape(xy + half), _HEIGHT_M) for k, xy in enumerate(np.vstack(feet))
    ]


def _number_feature(painter: Painter, row: SlotRow, slot: int) -> dict:
    corners = painter.surface.drape(number_box(row, slot)).round(4).tolist()
    return {
        "type": "Feature",
        "id": f"num_{row.name}_{slot}",
        "properties": {"class": "slot_number", "text": slot_number(row, slot)},
        "geometry": {"type": "Polygon", "coordinates": [[*corners, corners[0]]]},
    }
