"""A random street: lanes, marks, what stands beside it (room: simulation; host).

In: a random generator. Out: Scene, seen from s = 0 to s = 60 m of its path.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.simulation.paint import GroundArea, PaintedGround, wear_pattern
from semloc_jax.simulation.path import PlanePath, winding_path
from semloc_jax.simulation.scene import Scene
from semloc_jax.simulation.solids import Solid
from semloc_jax.simulation.streets import things
from semloc_jax.simulation.streets.marks import (
    CrossSection,
    decoys,
    hatched,
    junction_marks,
    lane_marks,
    random_cross_section,
)
from semloc_jax.simulation.surface import Surface, rolling_surface

_BEHIND_M, _AHEAD_M = 8.0, 150.0
VIEWED_M = 60.0
"""Length of the path that cameras stand on."""


def random_street(rng: np.random.Generator) -> Scene:
    """A street with the vehicle's lane around d = 0."""
    start, end = -_BEHIND_M, VIEWED_M + _AHEAD_M
    path = winding_path(rng, start - 10.0, end + 10.0, rng.uniform(0.0, 0.012), rng.uniform(-np.pi, np.pi))
    surface = rolling_surface(rng)
    lanes = random_cross_section(rng, start, end)
    marks = list(decoys(path, lanes, rng))
    marks += lane_marks(path, lanes, rng)
    junctions = np.arange(rng.uniform(2.0, 30.0), end, rng.uniform(18.0, 90.0)) if rng.random() < 0.75 else np.zeros(0)
    for s in junctions.tolist():
        marks += junction_marks(path, lanes, s, rng)
    if rng.random() < 0.25:
        marks += hatched(path, lanes, rng)
    areas, verge_m = _areas(path, lanes, rng)
    ground = PaintedGround(
        [shape for shape, _ in marks],
        [kind for _, kind in marks],
        areas,
        CLASS_IDS["terrain"],
        wear_pattern(rng.uniform(0.0, 0.06), rng) if rng.random() < 0.5 else None,
    )
    solids = _solids(_Line(path, surface, lanes), verge_m, junctions, rng)
    return Scene((), surface, ground, tuple(solids), lambda time_s: (), path, CLASS_IDS["sky"])


def _areas(
    path: PlanePath, lanes: CrossSection, rng: np.random.Generator
) -> tuple[list[GroundArea], tuple[float, float]]:
    """Asphalt, kerbs, sidewalks; and how far from the outer borders of the lanes things may stand, right and left."""
    s = np.arange(lanes.start_m, lanes.end_m, 1.5)
    low, high = lanes.borders[0], lanes.borders[-1]
    shoulder = rng.uniform(0.15, 0.6) if rng.random() < 0.6 else rng.uniform(0.6, 2.8)
    strips = [("road", low - shoulder, high + shoulder)]
    verge = [0.3, 0.3]
    for side in (0, 1):
        if rng.random() < 0.55:
            curb, walk = rng.uniform(0.1, 0.35), rng.uniform(0.8, 4.0) * (rng.random() < 0.8)
            verge[side] = curb + 0.25
            edge, sign = (low - shoulder, -1.0) if side == 0 else (high + shoulder, 1.0)
            strips.append(("curb", *sorted((edge, edge + sign * curb))))
            strips.append(("sidewalk", *sorted((edge + sign * curb, edge + sign * (curb + walk + 0.01)))))
    areas = [
        GroundArea(CLASS_IDS[name], np.vstack([path.at(s, right), path.at(s, left)[::-1]]))
        for name, right, left in strips
    ]
    return areas, (shoulder + verge[0], shoulder + verge[1])


class _Roadside:
    """One side of the street, where things stand: `beyond` metres from its edge, away from the lanes."""

    def __init__(self, street: "_Line", edge_m: float, side: float, rng: np.random.Generator) -> None:
        self.street, self.edge_m, self.side, self.rng = street, edge_m, side, rng

    def place(self, s: float, least_m: float, most_m: float) -> np.ndarray:
        """Somewhere beyond the edge."""
        return self.street.place(s, self.edge_m + self.side * self.rng.uniform(least_m, most_m))

    def rows(self) -> list[Solid]:
        """Everything that stands in rows."""
        rng, lanes = self.rng, self.street.lanes
        solids: list[Solid] = []
        for chance, pitch_m, made in (
            (0.5, (12.0, 50.0), lambda s: things.delineator(self.place(s, 0.0, 0.5), rng)),
            (0.5, (18.0, 45.0), lambda s: things.lamp(self.place(s, 0.0, 1.5), self.street.across(s, -self.side), rng)),
            (0.85, (8.0, 35.0), self.sign),
            (0.3, (25.0, 60.0), self.large_sign),
            (0.35, (12.0, 40.0), lambda s: things.plain_pole(self.place(s, 0.0, 3.0), rng)),
            (0.7, (5.0, 25.0), lambda s: things.tree(self.place(s, 1.5, 12.0), rng)),
            (0.5, (2.0, 9.0), lambda s: things.bush(self.place(s, 1.0, 6.0), rng)),
            (0.25, (1.0, 5.0), lambda s: things.trunk(self.place(s, 2.5, 14.0), rng)),
            (0.25, (5.0, 9.0), lambda s: things.fence(self.place(s, 1.0, 4.0), self.street.heading(s), rng)),
        ):
            solids += _row(lanes, rng, chance, pitch_m, made)
        away = rng.uniform(1.5, 20.0)
        return solids + _row(lanes, rng, 0.5, (14.0, 30.0), lambda s: self.front(s, away))

    def sign(self, s: float) -> list[Solid]:
        """A sign that faces either direction."""
        base = self.place(s, 0.0, 1.5)
        facing = self.street.heading(s) + np.pi * self.rng.integers(2) + self.rng.normal(0.0, 0.2)
        return things.sign(base, facing, self.rng)

    def large_sign(self, s: float) -> list[Solid]:
        """A board that faces either direction."""
        facing = self.street.heading(s) + np.pi * self.rng.integers(2) + self.rng.normal(0.0, 0.1)
        return things.large_sign(self.place(s, 0.5, 4.0), facing, self.rng)

    def front(self, s: float, away_m: float) -> list[Solid]:
        """A house."""
        base = self.place(s, away_m, away_m + 2.0)
        return things.front(base, self.street.heading(s), self.side, self.rng)

    def rail(self) -> list[Solid]:
        """A guard rail along a part of the edge."""
        begin = self.rng.uniform(self.street.lanes.start_m, 40.0)
        stations = np.arange(begin, begin + self.rng.uniform(20.0, 90.0), 2.5).tolist()
        points = np.array([self.street.place(s, self.edge_m + 0.2 * self.side) for s in stations])
        return things.rail(points, self.rng)


class _Line(NamedTuple):
    """The line of the street on its ground."""

    path: PlanePath
    surface: Surface
    lanes: CrossSection

    def place(self, s: float, d: float) -> np.ndarray:
        """Ground point [3] at (s, d)."""
        return self.surface.drape(self.path.at(np.array([s]), np.array([d])))[0]

    def heading(self, s: float) -> float:
        """Heading of the path [rad]."""
        return float(self.path.heading_at(np.array([s]))[0])

    def across(self, s: float, side: float) -> np.ndarray:
        """Unit direction to the left of the path (side 1) or to the right (-1)."""
        heading = self.heading(s)
        return side * np.array([-np.sin(heading), np.cos(heading), 0.0])


def _solids(
    street: _Line, verge_m: tuple[float, float], junctions: np.ndarray, rng: np.random.Generator
) -> list[Solid]:
    """Everything that stands, on both sides, and the traffic."""
    low, high = street.lanes.borders[0] - verge_m[0], street.lanes.borders[-1] + verge_m[1]
    solids: list[Solid] = []
    for edge, side in ((low, -1.0), (high, 1.0)):
        roadside = _Roadside(street, edge, side, rng)
        solids += roadside.rows()
        if rng.random() < 0.25:
            solids += roadside.rail()
    for s in junctions.tolist():
        for edge, side in ((low, -1.0), (high, 1.0)):
            if rng.random() < 0.6:
                base, facing = street.place(s + 1.0, edge + 0.3 * side), street.heading(s) + np.pi
                solids += things.signal_mast(base, street.across(s, -side), facing, rng)
    if rng.random() < 0.2:
        s = rng.uniform(15.0, 90.0)
        left, right = street.place(s, high + 0.5), street.place(s, low - 0.5)
        solids += things.gantry(left, right, street.heading(s) + np.pi, rng)
    return solids + _traffic(street, rng)


def _traffic(street: _Line, rng: np.random.Generator) -> list[Solid]:
    """Vehicles in the lanes, and some that stand at the edge."""
    lanes, solids = street.lanes, []
    for k, d in enumerate((*lanes.lane_middles, lanes.borders[0] - 1.0)):
        is_oncoming = lanes.center > 0 and d > lanes.borders[lanes.center]
        is_own = abs(d) < 0.5
        if rng.random() < (0.35 if k == len(lanes.lane_middles) else 0.75):
            first = rng.uniform(72.0, 110.0) if is_own else rng.uniform(-5.0, 50.0)
            for s in np.arange(first, lanes.end_m - 5.0, rng.uniform(9.0, 60.0)).tolist():
                base = street.place(s, d + rng.normal(0.0, 0.2))
                heading = street.heading(s) + (np.pi if is_oncoming else 0.0) + rng.normal(0.0, 0.02)
                solids += things.vehicle(base, heading, rng)
    return solids


def _row(
    lanes: CrossSection,
    rng: np.random.Generator,
    chance: float,
    pitch_m: tuple[float, float],
    made: Callable[[float], list[Solid]],
) -> list[Solid]:
    """Things along the street, if there are any, about one pitch apart."""
    if rng.random() >= chance:
        return []
    pitch = rng.uniform(*pitch_m)
    places = np.arange(rng.uniform(lanes.start_m, lanes.start_m + pitch), min(lanes.end_m, 130.0), pitch)
    return [solid for s in (places + rng.uniform(-0.25, 0.25, len(places)) * pitch).tolist() for solid in made(s)]
