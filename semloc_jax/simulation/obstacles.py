"""What stands on parking slots to keep them free: ground locks, no-parking signs, cones (room: simulation; host).

In: a World with slots, a random generator. Out: the World with obstacles on some slots, as bodies and in its map.
"""

from dataclasses import replace

import numpy as np

from semloc_jax.maps import MapElement
from semloc_jax.simulation import elements as make
from semloc_jax.simulation.scene import World
from semloc_jax.simulation.solids import Box, Plate, Solid, rotation_about_z
from semloc_jax.structs import ElementClass

OBSTACLE_IDS = {"ground_lock": 28, "no_parking_sign": 29}
"""Class ids in masks of what no map class is for."""
_LOCK_M = (0.16, 0.56, 0.4)
_SIGN_M = (0.42, 0.46, 0.78)
"""Length along yaw, width, height."""
_LOCK_SHARE, _SIGN_SHARE, _CONE_SHARE = 0.16, 0.07, 0.08
_SIZE_NOTE = "length along yaw, width, height (m); the point is the middle of the footprint on the ground"


def with_obstacles(world: World, rng: np.random.Generator) -> tuple[World, dict[str, int], set[str]]:
    """The world with obstacles, how many there are of each kind, and the slots that they keep free."""
    features: list[dict] = []
    cones: list[MapElement] = []
    bodies: list[Solid] = []
    kept: set[str] = set()
    for slot in [e for e in world.elements if e.label == ElementClass.PARKING_SLOT]:
        draw, wobble = rng.random(), rng.normal(size=3)
        front, inward = _axes(slot)
        yaw = float(np.arctan2(inward[1], inward[0]) + 0.03 * wobble[2])
        if draw < _LOCK_SHARE:
            place = _ground(world, front + (1.1 + 0.1 * wobble[0]) * inward)
            is_raised = bool(rng.random() < 0.7)
            size = (*_LOCK_M[:2], _LOCK_M[2] if is_raised else 0.08)
            name = f"lock_{len(features)}"
            told = {"state": "raised" if is_raised else "lowered"}
            features.append(_feature(name, "ground_lock", place, yaw, size, slot, told))
            bodies += _lock(place, yaw, size)
            kept |= {slot.id} if is_raised else set()
        elif draw < _LOCK_SHARE + _SIGN_SHARE:
            place = _ground(world, front + (1.4 + 0.2 * wobble[0]) * inward)
            features.append(
                _feature(f"nopark_{len(features)}", "no_parking_sign", place, yaw, _SIGN_M, slot, {"kind": "a_frame"})
            )
            bodies += _a_frame(place, yaw)
            kept.add(slot.id)
        elif draw < _LOCK_SHARE + _SIGN_SHARE + _CONE_SHARE:
            place = _ground(world, front + (1.0 + 0.3 * abs(wobble[0])) * inward)
            cones.append(make.cone(f"xcone_{len(cones)}", place))
            kept.add(slot.id)
    counts = {name: sum(f["properties"]["class"] == name for f in features) for name in OBSTACLE_IDS}
    elements, more = (*world.elements, *cones), (*world.features, *features)
    full = replace(world, elements=elements, features=more, bodies=(*world.bodies, *bodies))
    return full, {**counts, "extra_cones": len(cones)}, kept


def _axes(slot: MapElement) -> tuple[np.ndarray, np.ndarray]:
    """Middle of the entrance [2] and direction to the back [2]."""
    corners = slot.points[:, :2]
    front, back = corners[:2].mean(axis=0), corners[2:].mean(axis=0)
    return front, (back - front) / np.linalg.norm(back - front)


def _ground(world: World, xy: np.ndarray) -> np.ndarray:
    return world.surface.drape(xy[None])[0]


def _feature(name: str, kind: str, place: np.ndarray, yaw: float, size: tuple, slot: MapElement, told: dict) -> dict:
    properties = {"class": kind, "yaw": round(yaw, 5), "size": list(size), "size_note": _SIZE_NOTE, **told}
    geometry = {"type": "Point", "coordinates": [round(float(value), 4) for value in place]}
    return {"type": "Feature", "id": name, "properties": {**properties, "slot": slot.id}, "geometry": geometry}


def _lock(place: np.ndarray, yaw: float, size: tuple) -> list[Solid]:
    """A foot, and when it is raised an arm over it."""
    R, yellow, kind = rotation_about_z(yaw), (0.1, 0.7, 0.85), OBSTACLE_IDS["ground_lock"]
    length_m, width_m, height_m = size
    foot = Box(kind, (0.2, 0.2, 0.2), place + [0.0, 0.0, 0.02], (length_m, width_m, 0.12), R)
    if height_m < 0.2:
        return [foot]
    bars: list[Solid] = [foot]
    for side in (-0.5, 0.5):
        at = place + R @ np.array([0.0, side * (width_m - 0.06), 0.5 * height_m])
        bars.append(Box(kind, yellow, at, (0.06, 0.06, height_m), R))
    return [*bars, Box(kind, yellow, place + [0.0, 0.0, height_m - 0.03], (0.06, width_m, 0.06), R)]


def _a_frame(place: np.ndarray, yaw: float) -> list[Solid]:
    """Two boards that lean against each other."""
    R, red, kind = rotation_about_z(yaw), (0.2, 0.2, 0.8), OBSTACLE_IDS["no_parking_sign"]
    length_m, width_m, height_m = _SIGN_M
    boards: list[Solid] = []
    for side in (-1.0, 1.0):
        x, y = 0.5 * side * length_m, 0.5 * width_m
        corners = np.array([[x, -y, 0.0], [x, y, 0.0], [0.0, y, height_m], [0.0, -y, height_m]])
        boards.append(Plate(kind, red, place + corners @ R.T))
    return boards
