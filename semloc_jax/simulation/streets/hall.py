"""A random garage: slots of many makes, pillars, parked cars, walls (room: simulation; host).

In: a random generator. Out: Scene, seen from s = 0 to s = `VIEWED_M` of its path. Its backdrop is a wall: the light is
that of lamps below a ceiling.
"""

from typing import NamedTuple

import numpy as np
import shapely

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.simulation.garage import garage_floor
from semloc_jax.simulation.looks.materials import BANDED, BLUE, RED, STRIPED, TAR, WHITE, YELLOW, variant_id
from semloc_jax.simulation.paint import GroundArea, PaintedGround, wear_pattern
from semloc_jax.simulation.path import PlanePath, winding_path
from semloc_jax.simulation.scene import Scene
from semloc_jax.simulation.solids import Box, Frustum, Solid, own_body, rotation_about_z
from semloc_jax.simulation.streets import things
from semloc_jax.simulation.streets.marks import CrossSection, Mark, decoys, junction_marks, ribbon, strokes
from semloc_jax.simulation.surface import Surface

VIEWED_M = 30.0
_PAST_M = 14.0
_CLEAR_M = 1.3
"""Nothing stands so near to the path."""
_PLAIN_WALL = variant_id("wall", 1)
"""A wall without windows."""


class _Hall(NamedTuple):
    """Sizes of a garage; d [m] to the left of the path."""

    path: PlanePath
    floor: Surface
    aisle_m: float
    """From the path to the slots of either side."""
    slot_m: tuple[float, float]
    """Width along the path and depth across."""
    lean: float
    """How far slots slant along the path for each metre across."""
    height_m: float
    columns: np.ndarray
    """Where the lines between slots begin [m]."""

    def place(self, s: float, d: float) -> np.ndarray:
        """Floor point [3] at (s, d)."""
        return self.floor.drape(self.path.at(np.array([s]), np.array([d])))[0]

    def turned(self, s: float, more_rad: float = 0.0) -> np.ndarray:
        """R of the heading of the path at s, turned further."""
        return rotation_about_z(float(self.path.heading_at(np.array([s]))[0]) + more_rad)

    @property
    def wall_m(self) -> float:
        """From the path to the walls."""
        return self.aisle_m + self.slot_m[1] + 1.2


def random_hall(rng: np.random.Generator) -> Scene:
    """A garage with slots on one or both sides of an aisle."""
    start, end = -_PAST_M, VIEWED_M + _PAST_M
    path = winding_path(rng, start - 10.0, end + 10.0, rng.uniform(0.0, 0.01), rng.uniform(-np.pi, np.pi))
    slot = rng.uniform(2.2, 3.0), rng.uniform(4.4, 5.8)
    lean = 0.0 if rng.random() < 0.7 else rng.uniform(-0.6, 0.6)
    columns = np.arange(start, end, slot[0])
    hall = _Hall(path, garage_floor(rng), rng.uniform(2.4, 3.8), slot, lean, rng.uniform(2.4, 3.4), columns)
    sides = ((1.0, -1.0), (1.0,), (-1.0,))[int(rng.choice(3, p=(0.8, 0.1, 0.1)))]
    lanes = CrossSection((-hall.aisle_m, 0.0, hall.aisle_m), 1 if rng.random() < 0.5 else -1, start, end)
    marks = [mark for mark in decoys(path, lanes, rng) if rng.random() < 0.5]
    marks += _aisle_marks(hall, lanes, rng)
    solids = _walls(hall, rng) + _small_things(hall, rng)
    style = _SlotStyle.drawn(rng)
    for side in sides:
        marks += _slots(hall, side, style, rng)
        solids += _cars(hall, side, rng)
        solids += _pillars(hall, side, rng)
    s = np.arange(start - 3.0, end + 3.0, 1.5)
    outline = np.vstack([path.at(s, -hall.wall_m - 0.3), path.at(s, hall.wall_m + 0.3)[::-1]])
    ground = PaintedGround(
        [shape for shape, _ in marks],
        [kind for _, kind in marks],
        [GroundArea(CLASS_IDS["road"], outline)],
        CLASS_IDS["wall"],
        wear_pattern(rng.uniform(0.0, 0.06), rng) if rng.random() < 0.4 else None,
    )
    own = own_body()
    ego = (Box(own.class_id, tuple(rng.uniform(0.03, 0.9) * np.ones(3)), own.center, own.size_m, own.R_map_box),)
    return Scene((), hall.floor, ground, tuple(solids), lambda time_s: (), path, CLASS_IDS["wall"], ego)


class _SlotStyle(NamedTuple):
    """How the slots of a garage are painted."""

    kind: int
    width_m: float
    foot_m: float
    """Length of the bar at the entrance; 0 for none."""
    is_closed: bool
    """Whether a line runs along the entrances."""
    is_numbered: bool

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "_SlotStyle":
        """One."""
        paint = (WHITE, YELLOW, BLUE, RED)[int(rng.choice(4, p=(0.7, 0.2, 0.05, 0.05)))]
        foot_m = rng.uniform(0.4, 1.4) * (rng.random() < 0.5)
        return cls(
            variant_id("slot_line", paint), rng.uniform(0.06, 0.2), foot_m, rng.random() < 0.2, rng.random() < 0.4
        )


def _slots(hall: _Hall, side: float, style: _SlotStyle, rng: np.random.Generator) -> list[Mark]:
    """Lines between slots, bars at their entrances, numbers in them."""
    half, deep = 0.5 * style.width_m, hall.slot_m[1] * (1.0 if rng.random() < 0.8 else 0.6)
    near, far = side * hall.aisle_m, side * (hall.aisle_m + deep)
    slant = hall.lean * deep
    marks: list[Mark] = []
    for s in hall.columns.tolist():
        corners = np.array([(s - half, near), (s + half, near), (s + slant + half, far), (s + slant - half, far)])
        marks.append((shapely.Polygon(hall.path.at(corners[:, 0], corners[:, 1])), style.kind))
        if style.foot_m:
            marks.append((_bar(hall, s, near, style.foot_m, style.width_m), style.kind))
        if style.is_numbered:
            begin = near + side * rng.uniform(0.3, 0.8) - (0.0 if side > 0 else 0.9)
            marks += strokes(hall.path, s + 0.3 * hall.slot_m[0], begin, 0.45, rng)
    if style.is_closed:
        length = float(hall.columns[-1] - hall.columns[0])
        marks.append((_bar(hall, float(hall.columns.mean()), near, length, style.width_m), style.kind))
    return marks


def _bar(hall: _Hall, s: float, d: float, length_m: float, width_m: float) -> shapely.Polygon:
    return ribbon(hall.path, s - 0.5 * length_m, s + 0.5 * length_m, d, width_m)


def _aisle_marks(hall: _Hall, lanes: CrossSection, rng: np.random.Generator) -> list[Mark]:
    """Arrows, stop lines and crosswalks in the aisle, a bump, joints of the floor."""
    marks: list[Mark] = []
    for s in np.arange(lanes.start_m + rng.uniform(0.0, 12.0), lanes.end_m, rng.uniform(8.0, 20.0)).tolist():
        narrow = CrossSection((-0.9 * hall.aisle_m, 0.0, 0.9 * hall.aisle_m), lanes.center, s - 5.0, s + 5.0)
        marks += junction_marks(hall.path, narrow, s, rng)
    if rng.random() < 0.3:
        marks.append(
            (ribbon(hall.path, lanes.start_m, lanes.end_m, 0.0, 0.12), variant_id("lane_solid", int(rng.integers(2))))
        )
    if rng.random() < 0.4:
        s = rng.uniform(0.0, VIEWED_M)
        marks.append((ribbon(hall.path, s, s + 0.35, 0.0, 1.8 * hall.aisle_m), CLASS_IDS["speed_bump"]))
    for s in np.arange(lanes.start_m, lanes.end_m, rng.uniform(3.0, 9.0)) if rng.random() < 0.5 else ():
        marks.insert(0, (ribbon(hall.path, s, s + 0.02, 0.0, 2.0 * hall.wall_m), variant_id("road", TAR)))
    return marks


def _pillars(hall: _Hall, side: float, rng: np.random.Generator) -> list[Solid]:
    """Pillars in a row, square or round, plain, painted below, or striped."""
    half, every = 0.5 * rng.uniform(0.25, 1.0), int(rng.integers(1, 5))
    across = hall.aisle_m + rng.choice([-0.1, 0.3, 0.5, 1.0]) * hall.slot_m[1] + rng.uniform(0.0, half)
    across = min(max(across, _CLEAR_M + 0.7 + half), hall.wall_m - half)
    tone = rng.uniform(0.25, 0.95)
    color = tuple((tone * (1.0 + rng.normal(0.0, 0.05, 3))).clip(0.05, 0.97).tolist())
    kind = variant_id("pillar", (0, STRIPED, BANDED)[int(rng.choice(3, p=(0.4, 0.45, 0.15)))])
    is_round, lower_m = rng.random() < 0.2, rng.uniform(0.5, 1.5) * (rng.random() < 0.4)
    lower = tuple(rng.uniform(0.03, 0.9, 3).tolist())
    solids: list[Solid] = []
    for s in hall.columns[int(rng.integers(every)) :: every].tolist():
        base = hall.place(s + hall.lean * (across - hall.aisle_m), side * across)
        if is_round:
            solids.append(Frustum(kind, color, base - [0.0, 0.0, 0.1], hall.height_m + 0.1, half, half))
            continue
        R = hall.turned(s)
        solids.append(_upright(kind, color, base, (2 * half, 2 * half, hall.height_m), R))
        if lower_m:
            solids.append(
                _upright(variant_id("pillar", 0), lower, base, (2 * half + 0.01, 2 * half + 0.01, lower_m), R)
            )
    return solids


def _upright(kind: int, color: tuple, base: np.ndarray, size_m: tuple[float, float, float], R: np.ndarray) -> Box:
    """A box on the floor, its foot a little below."""
    middle = base + [0.0, 0.0, 0.5 * size_m[2] - 0.1]
    return Box(kind, color, middle, (size_m[0], size_m[1], size_m[2] + 0.2), R)


def _cars(hall: _Hall, side: float, rng: np.random.Generator) -> list[Solid]:
    share, solids = rng.uniform(0.1, 0.8), []
    for s in hall.columns.tolist():
        if rng.random() < share:
            across = hall.aisle_m + 0.5 * hall.slot_m[1] + rng.uniform(-0.2, 0.4)
            base = hall.place(s + 0.5 * hall.slot_m[0] + hall.lean * (across - hall.aisle_m), side * across)
            turn = 0.5 * np.pi * rng.choice([-1.0, 1.0]) - side * np.arctan(hall.lean) + rng.normal(0.0, 0.03)
            heading = float(hall.path.heading_at(np.array([s]))[0]) + turn
            solids += things.vehicle(base, heading, rng, kinds=(0.92, 0.08, 0.0))
    return solids


def _walls(hall: _Hall, rng: np.random.Generator) -> list[Solid]:
    """Walls with a coloured band, pipes below the ceiling, doors; the ends of the hall."""
    tone, solids = things.grey(rng, 0.25, 0.95), []
    band, pipe = (tuple(rng.uniform(0.03, 0.85, 3).tolist()) for _ in range(2))
    has_band, has_pipe, at_m, thick_m = (
        rng.random() < 0.6,
        rng.random() < 0.6,
        rng.uniform(0.4, 1.6),
        rng.uniform(0.1, 0.6),
    )
    for side in (1.0, -1.0):
        for s in np.arange(-_PAST_M, VIEWED_M + _PAST_M, 4.0).tolist():
            base, R = hall.place(s + 2.0, side * hall.wall_m), hall.turned(s + 2.0)
            solids.append(_upright(_PLAIN_WALL, tone, base, (4.1, 0.2, hall.height_m), R))
            if has_band:
                solids.append(Box(_PLAIN_WALL, band, base + [0.0, 0.0, at_m], (4.1, 0.22, thick_m), R))
            if has_pipe:
                above = hall.place(s + 2.0, side * (hall.wall_m - 0.4)) + [0.0, 0.0, hall.height_m - 0.35]
                solids.append(Box(_PLAIN_WALL, pipe, above, (4.1, 0.12, 0.12), R))
            if rng.random() < 0.15:
                solids.append(_upright(_PLAIN_WALL, things.grey(rng), base, (0.9, 0.25, 2.0), R))
    for s in (-_PAST_M, VIEWED_M + _PAST_M):
        size = 0.2, 2.0 * hall.wall_m, hall.height_m
        solids.append(_upright(_PLAIN_WALL, tone, hall.place(s, 0.0), size, hall.turned(s)))
    return solids


def _small_things(hall: _Hall, rng: np.random.Generator) -> list[Solid]:
    """Cones, boxes, bollards and signs beside the way."""
    solids: list[Solid] = []
    for s in np.arange(-5.0, VIEWED_M + 8.0, rng.uniform(3.0, 12.0)).tolist():
        d = rng.choice([-1.0, 1.0]) * rng.uniform(_CLEAR_M + 0.8, hall.aisle_m + 1.0)
        base, kind = hall.place(s + rng.uniform(-1.0, 1.0), float(d)), rng.random()
        if kind < 0.35:
            solids.append(Frustum(CLASS_IDS["cone"], (0.1, 0.35, 0.95), base, 0.7, 0.17, 0.02))
            solids.append(_upright(CLASS_IDS["cone"], (0.1, 0.35, 0.95), base, (0.4, 0.4, 0.05), hall.turned(s)))
        elif kind < 0.5:
            size = tuple(rng.uniform(0.2, 1.2, 3).tolist())
            solids.append(_upright(_PLAIN_WALL, tuple(rng.uniform(0.05, 0.9, 3).tolist()), base, size, hall.turned(s)))
        elif kind < 0.8:
            facing = float(hall.path.heading_at(np.array([s]))[0]) + np.pi * rng.integers(2) + rng.normal(0.0, 0.2)
            size, shape = rng.uniform(0.3, 1.0), str(rng.choice(["circle", "rectangle", "triangle", "octagon"]))
            # Below the ceiling, or on a post or a rail as high as a camera sees it.
            top_m = hall.height_m - 0.1 if rng.random() < 0.5 else rng.uniform(1.1, 2.2)
            center = base + [0.0, 0.0, top_m - 0.5 * size]
            solids += things.board(center, facing, shape, (size * rng.uniform(1.0, 2.0), size), 0.02, rng)
        elif kind < 0.9:
            solids += things.delineator(base, rng)
    return solids
