"""Worlds that are driven along a whole way: laps, stops, a place to park (room: simulation; host).

In: a kind, seeds, how to drive. Out: Tour.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from semloc_jax.maps import MapElement
from semloc_jax.simulation.elements import ARROW_TIP
from semloc_jax.simulation.loop import build_loop, plan_loop
from semloc_jax.simulation.loop_drive import drive_loop, loop_traffic
from semloc_jax.simulation.motion import DrivingStyle, TrueMotion
from semloc_jax.simulation.obstacles import with_obstacles
from semloc_jax.simulation.parking import build_hall, with_cars
from semloc_jax.simulation.parking_drive import choose_target, drive_parking
from semloc_jax.simulation.parking_lot import build_lot
from semloc_jax.simulation.parking_plan import ParkingPlan, plan_parking
from semloc_jax.simulation.scene import World
from semloc_jax.structs import ElementClass

_GATE_M, _GATE_RAD = 0.4, 0.0349
"""How well the gate of a garage knows where a vehicle comes in."""
_NUM_SURVEYED = 6


@dataclass(frozen=True)
class Tour:
    """A world and the whole drive through it.

    Args:
        world: the world.
        motion: of the vehicle.
        end_s: time of the last frame, the first one being at 0.
        has_gnss: whether satellites are in view.
        told: what meta.json says about the drive.
    """

    world: World
    motion: TrueMotion
    end_s: float
    has_gnss: bool = True
    told: dict = field(default_factory=dict)


@dataclass(frozen=True)
class TourWish:
    """What a tour should be like.

    Args:
        speed_mps: on the straight.
        laps: how often to go round.
        wear_share: share of the paint that is worn off.
        has_obstacles: whether locks, signs and cones keep slots free (garage, lot).
    """

    speed_mps: float
    laps: int
    wear_share: float
    has_obstacles: bool = False


def loop_tour(rng: np.random.Generator, own: np.random.Generator, wish: TourWish) -> Tour:
    """A closed town road: `rng` for the world, `own` for the drive."""
    plan = plan_loop(rng)
    world = build_loop(plan, rng, wish.wear_share)
    tour = drive_loop(plan, world.surface, wish.laps, DrivingStyle(wish.speed_mps), own)
    world = replace(world, traffic=loop_traffic(plan, world.surface, tour, own))
    road = plan.line.unrolled(0.0, plan.line.length_m)
    told = {
        "laps": wish.laps,
        "lap_length_m": round(plan.line.length_m, 3),
        "stops": [list(stop) for stop in tour.stops],
        "intersections": [
            {
                "tag": place.tag,
                "s": round(place.s_m, 3),
                "twin": place.is_twin,
                "center": _rounded(world.surface.drape(road.at(np.array([place.s_m])))[0]),
            }
            for place in plan.intersections
        ],
    }
    return Tour(world, tour.motion, tour.end_s, told=told)


def hall_tour(rng: np.random.Generator, own: np.random.Generator, wish: TourWish) -> Tour:
    """A garage with rings of aisles: `rng` for the world, `own` for the cars in it and the drive."""
    plan = plan_parking(rng, (3, 4), (1, 2))
    world = build_hall(plan, rng, wish.wear_share)
    surveyed = _surveyed(world, rng)
    tour = _parking_tour(plan, world, wish, rng, own)
    first = tour.motion.pose(0.0)
    told = {"entrance_fix": _entrance_fix(first, own), "surveyed": surveyed}
    return replace(tour, has_gnss=False, told={**told, **tour.told})


def lot_tour(rng: np.random.Generator, own: np.random.Generator, wish: TourWish) -> Tour:
    """An open parking lot: `rng` for the world, `own` for the cars on it and the drive."""
    plan = plan_parking(rng, (2, 3), (1, 2))
    return _parking_tour(plan, build_lot(plan, rng, wish.wear_share), wish, rng, own)


def _parking_tour(
    plan: ParkingPlan, world: World, wish: TourWish, rng: np.random.Generator, own: np.random.Generator
) -> Tour:
    """Rings through a garage or a lot that end in a slot, with cars and obstacles in other slots."""
    counts, kept = {}, set()
    if wish.has_obstacles:
        world, counts, kept = with_obstacles(world, rng)
    target = choose_target(plan, wish.laps, own, kept)
    style = DrivingStyle(wish.speed_mps, sideways_mps2=0.9, braking_mps2=0.8)
    drive = drive_parking(plan, world.surface, wish.laps, style, target, own)
    free = {*kept, *(target.row.slot_id(slot) for slot in target.num_beside)}
    now = with_cars(world, plan, free, float(own.uniform(0.4, 0.6)), own)
    told = {
        "laps": wish.laps,
        "target_slot": target.row.slot_id(target.slot),
        "reverse_from_s": round(drive.reverse_s, 3),
        "route_m": round(float(drive.path.s_m[-1] - drive.path.s_m[0]), 3),
    }
    if wish.has_obstacles:
        told["obstacles"] = counts
    return Tour(now, drive.motion, drive.end_s, told=told)


def _entrance_fix(T_map_base: np.ndarray, rng: np.random.Generator) -> dict:
    """The place of the first frame, as a gate would tell it: with errors of the stated size."""
    east, north, up = T_map_base[:3, 3] + rng.normal(size=3) * [_GATE_M, _GATE_M, 0.05]
    yaw = float(np.arctan2(T_map_base[1, 0], T_map_base[0, 0])) + _GATE_RAD * float(rng.normal())
    place = {"east_m": round(float(east), 3), "north_m": round(float(north), 3), "up_m": round(float(up), 3)}
    return {"t": 0.0, **place, "yaw_rad": round(yaw, 4), "sigma_m": _GATE_M, "sigma_yaw_rad": _GATE_RAD}


def _surveyed(world: World, rng: np.random.Generator) -> list[dict]:
    """Exact distances between corners of slots and tips of arrows, from short to long."""
    slots = [e for e in world.elements if e.label == ElementClass.PARKING_SLOT]
    arrows = [e for e in world.elements if e.label == ElementClass.ROAD_MARK]
    pairs = []
    for number in range(_NUM_SURVEYED):
        a = slots[int(rng.integers(len(slots)))]
        others = arrows if number % 2 == 0 and arrows else slots
        b = others[int(rng.integers(len(others)))]
        ends = [_surveyed_point(element) for element in (a, b)]
        distance_m = float(np.linalg.norm(np.subtract(ends[0]["point"], ends[1]["point"])))
        pairs.append({"a": ends[0], "b": ends[1], "distance_m": round(distance_m, 4)})
    return sorted(pairs, key=lambda pair: pair["distance_m"])


def _surveyed_point(element: MapElement) -> dict:
    """The corner of a slot or the tip of an arrow, as the map has it."""
    if element.label == ElementClass.PARKING_SLOT:
        what, point = (
            "entrance corner 0 of the slot (where the centre lines of two painted bars meet)",
            element.points[0],
        )
    else:
        what, point = "tip of the arrow", element.points[ARROW_TIP]
    return {"id": element.id, "what": what, "point": [round(float(value), 4) for value in point]}


def _rounded(point: np.ndarray) -> list[float]:
    return [round(float(value), 3) for value in point]
