"""How a closed road is driven, and what else drives on it (room: simulation; host).

In: a LoopPlan, laps. Out: the way and its time table, stops, traffic.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from semloc_jax.simulation.intersection import LANE_M
from semloc_jax.simulation.loop import LoopPlan
from semloc_jax.simulation.motion import DrivingStyle, RouteMotion, driven_line, on_table, timed
from semloc_jax.simulation.path import PlanePath
from semloc_jax.simulation.solids import Solid, car
from semloc_jax.simulation.surface import Surface

_BEFORE_M, _BEHIND_M = 90.0, 60.0
_CHANGE_M = 9.0
"""Standard deviation of the smoothing of lane changes along the way."""
_STOP_SHARE, _STOP_BEFORE_M = 0.3, 4.6
"""The front bumper stands before the line when the rear axle is so far from it."""
_SEEN_M = 260.0
_COLORS = ((0.85, 0.85, 0.85), (0.15, 0.12, 0.1), (0.45, 0.2, 0.12), (0.12, 0.12, 0.5), (0.5, 0.5, 0.48))


@dataclass(frozen=True)
class LoopTour:
    """One drive round a closed road.

    Args:
        motion: where the vehicle is.
        path: line that it drives.
        end_s: time at which it is back after its last lap.
        stops: time and duration of each stop [s].
    """

    motion: RouteMotion
    path: PlanePath
    end_s: float
    stops: tuple[tuple[float, float], ...]


def drive_loop(plan: LoopPlan, surface: Surface, laps: int, style: DrivingStyle, rng: np.random.Generator) -> LoopTour:
    """Drive `laps` laps from the start of the plan: odd ones partly in the other lane where there are two."""
    length_m = plan.line.length_m
    first, last = plan.start_m - _BEFORE_M, plan.start_m + laps * length_m + _BEHIND_M
    road = plan.line.unrolled(first - 1.0, last + 1.0)
    s = np.arange(first, last, 0.1)
    path = driven_line(road.at(s, _lateral(plan, s, rng)))
    # Places along the middle of the road, as places along the line that is driven.
    stops = sorted(_stops(plan, laps, rng))
    on_way = on_table(np.interp([at for at, _ in stops], s, path.s_m), path.s_m[0])
    start_m = float(np.interp(plan.start_m, s, path.s_m))
    end_m = float(np.interp(plan.start_m + laps * length_m, s, path.s_m))
    times = [(float(at), duration) for at, (_, duration) in zip(on_way, stops, strict=True)]
    motion = timed(path, surface, style, times, (path.s_m[0], path.s_m[-1]), start_m, rng)
    end_s = float(np.interp(end_m, motion.s_m, motion.time_s))
    stood = tuple((round(_arrival(motion, at), 3), round(duration, 3)) for at, duration in times)
    return LoopTour(motion, path, end_s, stood)


def _arrival(motion: RouteMotion, s_m: float) -> float:
    """When the vehicle stands at a place of the table, to a centimetre."""
    return float(motion.time_s[np.searchsorted(motion.s_m, s_m - 0.01)])


def _lateral(plan: LoopPlan, s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """To the left of the middle of the road: in the right lane, in places in the one beside it, wandering a little."""
    half = plan.half_width(s)
    outer, inner = -(half - 0.5 * LANE_M), np.full_like(s, -0.5 * LANE_M)
    lap = np.floor((s - plan.start_m) / plan.line.length_m).astype(int)
    # On every second lap the inner lane over a seeded part of the wide road.
    begin, end = plan.wide_m
    change_m = begin + (end - begin) * float(rng.uniform(0.55, 0.85))
    place = np.mod(s, plan.line.length_m)
    is_inner = (lap % 2 == 1) & (place < change_m) & (place > begin - 40.0)
    share = gaussian_filter1d(is_inner.astype(float), _CHANGE_M / 0.1, mode="nearest")
    wander = sum(
        size * np.sin(2.0 * np.pi * s / wave + rng.uniform(0.0, 2.0 * np.pi))
        for size, wave in ((0.12, 71.0), (0.08, 29.0))
    )
    return (1.0 - share) * outer + share * inner + wander


def _stops(plan: LoopPlan, laps: int, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Place along the road [m] and duration [s] of the stops: at some lines of some laps, at least one on each lap."""
    stops = []
    for lap in range(laps):
        chosen = rng.random(len(plan.intersections)) < _STOP_SHARE
        chosen[int(rng.integers(len(chosen)))] = True
        for place, is_stop in zip(plan.intersections, chosen, strict=True):
            duration_s = float(rng.uniform(2.0, 5.5))
            at = place.open_m[0] - _STOP_BEFORE_M - float(rng.uniform(0.2, 0.9))
            # Laps are counted from the start of the drive, not from the start of the line.
            at += plan.line.length_m * (lap + (1 if at < plan.start_m else 0))
            if is_stop:
                stops.append((at, duration_s))
    return stops


def loop_traffic(
    plan: LoopPlan, surface: Surface, tour: LoopTour, rng: np.random.Generator
) -> Callable[[float], Sequence[Solid]]:
    """Cars that come towards the vehicle, and one that drives ahead on the same way."""
    length_m = plan.line.length_m
    road = plan.line.unrolled(-5.0, length_m + 5.0)
    count = max(2, round(length_m / float(rng.uniform(70.0, 150.0))))
    start_m, speed_mps = rng.uniform(0.0, length_m, count), rng.uniform(7.0, 11.0)
    colors = [_COLORS[int(k)] for k in rng.integers(len(_COLORS), size=count + 1)]
    lead_s = float(rng.uniform(3.5, 6.0))

    def cars(time_s: float) -> list[Solid]:
        here = tour.motion.pose(time_s)[:2, 3]
        s = np.mod(start_m - speed_mps * time_s, length_m)
        xy = road.at(s, plan.half_width(s) - 0.5 * LANE_M)
        heading = road.heading_at(s) + np.pi
        ahead = np.array([float(tour.motion.travelled_m(np.array([time_s + lead_s]))[0])])
        gap_m = float(ahead[0] - tour.motion.travelled_m(np.array([time_s]))[0])
        if gap_m > 9.0:
            # Close behind one another at a stop the two would overlap: then the one ahead has driven on.
            xy, heading = np.vstack([xy, tour.path.at(ahead)]), np.append(heading, tour.path.heading_at(ahead))
        near = np.linalg.norm(xy - here, axis=1) < _SEEN_M
        stands = surface.stand(xy[near], heading[near])
        shown = [color for color, is_near in zip(colors, near, strict=False) if is_near]
        return [solid for T, color in zip(stands, shown, strict=True) for solid in car(T[:3, 3], T[:3, :3], color)]

    return cars
