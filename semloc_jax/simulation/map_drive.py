"""A seeded drive on a real map, in the drive layout (room: simulation; host).

In: a map file, where to drive. Out: Drive of the drive just written.
"""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.datasets.base import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.maps import SemanticMap, read_lane_centers, read_map
from semloc_jax.simulation.cameras import front_rig
from semloc_jax.simulation.map_scene import build_map_world
from semloc_jax.simulation.motion import VehicleMotion
from semloc_jax.simulation.path import PlanePath
from semloc_jax.simulation.route import RouteWish, drivable, find_route
from semloc_jax.simulation.simulate import LEAD_IN_S, SimulationConfig, Staging, checked, write_drive
from semloc_jax.simulation.variation import variation

_log = logging.getLogger(__name__)
_COMFORT_MPS2 = 2.0
"""Sideways acceleration in the sharpest bend."""
_SLOWEST_MPS = 3.0
_SHORTEST_M = 2.0
_LARGE, _MARGIN_M, _NUM_TRIES = 5000, 400.0, 64
"""Maps of more elements are looked at only around the way; more than what is built on both sides of it."""


def simulate_on_map(
    map_path: str | Path,
    seed: int,
    out: str | Path,
    wish: RouteWish | None = None,
    config: SimulationConfig | None = None,
    rig: Rig | None = None,
) -> Drive:
    """Render a seeded drive on a map into the folder `out` and open it; one front camera unless `rig` says else.

    The vehicle follows lanes where the map knows them, else its markings. Length and speed decide the number of frames:
    `num_frames` plays no role, nor do lightings other than the first.

    Args:
        map_path: a map that `read_map` reads.
        seed: everything random follows from it, the way too where no start is given.
        out: folder, made if absent.
        wish: where to drive.
        config: size and errors of the drive; its speed is a limit.
        rig: other cameras.

    Raises:
        SemlocError: a map without anything to see or to drive along, a start off the map.

    >>> small = sj.SimulationConfig(width_px=96, height_px=60, rate_hz=1.0)
    >>> drive_there = sj.simulate_on_map(folder / "map.geojson", 0, tmp / "there", config=small)
    >>> len(drive_there) > 0
    True
    """
    wish = wish or RouteWish()
    config = checked("road", config or SimulationConfig())
    if config.epoch:
        raise SemlocError(f"epoch = {config.epoch}: a map of yours has no other epochs; expected 0")
    rng = np.random.default_rng([seed, 2])
    own = variation([seed, 2], config.drive, rng, has_own_pictures=False)
    semantic_map = read_map(map_path)
    lanes = read_lane_centers(map_path, semantic_map.origin)
    if not lanes:
        semantic_map = _surroundings(semantic_map, wish, rng)
        if wish.path is None:
            _log.warning(
                "map %s has no lanes: the way follows its markings; give another with --path", semantic_map.name
            )
    path, length_m = _drivable_path(find_route(lanes, semantic_map.elements, wish, rng), config)
    speed_mps = min(config.speed_mps, _bend_speed(path, length_m))
    world = build_map_world(semantic_map, lanes, path, length_m, speed_mps, config.wear_share, rng, own.rng)
    motion = VehicleMotion(path, world.scene.surface, speed_mps, 0.15, 0.15, own.rng.uniform(0.0, 2.0 * np.pi, 4))
    num_frames = max(1, round(length_m / speed_mps * config.rate_hz))
    told = {
        "map": Path(map_path).name,
        "length_m": round(length_m, 1),
        "speed_mps": round(speed_mps, 2),
        "left_out": world.left_out,
        "map_height_error_m": [round(value, 4) for value in world.height_error_m],
    }
    staging = Staging("map", seed, world.scene, motion, semantic_map.origin, semantic_map.name, told)
    rig = rig or front_rig(config.width_px, config.height_px)
    return write_drive(Path(out), staging, rig, replace(config, num_frames=num_frames), own)


def _drivable_path(route: np.ndarray, config: SimulationConfig) -> tuple[PlanePath, float]:
    """The route as a path with room before and after it, and its length [m].

    Raises:
        SemlocError: the route is too short.
    """
    length_m = float(np.linalg.norm(np.diff(route, axis=0), axis=1).sum())
    if length_m < _SHORTEST_M:
        raise SemlocError(
            f"the lane ends {length_m:.1f} m after the start; start earlier or elsewhere, or give --path FILE"
        )
    return drivable(route, (LEAD_IN_S + 1.0) * config.speed_mps + 40.0), length_m


def _surroundings(semantic_map: SemanticMap, wish: RouteWish, rng: np.random.Generator) -> SemanticMap:
    """The part of a large map that the drive can reach, all of a small one."""
    if semantic_map.num_elements <= _LARGE:
        return semantic_map
    radius_m, extent = wish.length_m + _MARGIN_M, semantic_map.extent[:, :2]
    if wish.path is not None:
        route = find_route((), (), wish, rng)
        centers = [route.mean(axis=0)]
    elif wish.start_xy is not None:
        centers = [np.array(wish.start_xy)]
    else:
        centers = list(rng.uniform(*extent, (_NUM_TRIES, 2)))
    for center in centers:
        found = semantic_map.query(center, radius_m).elements
        if found:
            rows = np.unique(semantic_map.rows_of(element.id for element in found))
            return semantic_map.with_elements(semantic_map.element_at(int(row)) for row in rows)
    x, y = centers[0]
    raise SemlocError(
        f"map {semantic_map.name} has nothing within {radius_m:.0f} m of ({x:.0f}, {y:.0f}); give --start "
        "near its roads: 'semloc inspect' shows its extent"
    )


def _bend_speed(path: PlanePath, length_m: float) -> float:
    """The speed at which the sharpest bend is still comfortable [m/s]."""
    s = np.arange(0.0, length_m, 0.5)
    heading = path.heading_at(s)
    bend = np.abs(np.gradient(heading, 0.5)).max() if len(s) > 2 else 0.0
    return max(_SLOWEST_MPS, float(np.sqrt(_COMFORT_MPS2 / max(bend, 1e-6))))
