"""Worlds that are driven along a whole way: laps, stops, a place to park (room: simulation; host).

In: a kind, seeds, how to drive. Out: Tour.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from semloc_jax.simulation.loop import build_loop, plan_loop
from semloc_jax.simulation.loop_drive import drive_loop, loop_traffic
from semloc_jax.simulation.motion import TrueMotion
from semloc_jax.simulation.route_motion import DrivingStyle
from semloc_jax.simulation.scene import World


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
    """

    speed_mps: float
    laps: int
    wear_share: float


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


def _rounded(point: np.ndarray) -> list[float]:
    return [round(float(value), 3) for value in point]
