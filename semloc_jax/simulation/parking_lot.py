"""An open parking lot: rows of slots under the sky, lamps, trees and a house around it (room: simulation; host).

In: a ParkingPlan, a random generator. Out: World without cars.
"""

import numpy as np

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import MapElement
from semloc_jax.simulation import elements as make
from semloc_jax.simulation.elements import Painter
from semloc_jax.simulation.paint import GroundArea, wear_pattern
from semloc_jax.simulation.parking import (
    aisle_marks,
    cones_beside,
    cross_marks,
    floor_outline,
    has_back,
    square_painter,
)
from semloc_jax.simulation.parking_plan import ParkingPlan
from semloc_jax.simulation.scene import World
from semloc_jax.simulation.slot_rows import row_elements
from semloc_jax.simulation.solids import Solid, house, own_body, tree
from semloc_jax.simulation.surface import rolling_surface

_SIDEWALK_M = 2.2
_LAMP_M = 7.0


def build_lot(plan: ParkingPlan, rng: np.random.Generator, wear_share: float) -> World:
    """A lot on a plan."""
    painter = square_painter(plan, rolling_surface(rng, grade=0.01, camber=0.012))
    elements = [e for row in plan.rows for e in row_elements(row, painter.surface, has_back(row), is_numbered=False)]
    for kind in (aisle_marks, cross_marks, cones_beside, _lamps):
        elements += kind(painter, plan, rng)
    floor = floor_outline(plan, 0.0)
    areas = (
        GroundArea(CLASS_IDS["sidewalk"], floor_outline(plan, _SIDEWALK_M)),
        GroundArea(CLASS_IDS["road"], floor),
    )
    return World(
        elements=tuple(elements),
        surface=painter.surface,
        areas=areas,
        rest=CLASS_IDS["terrain"],
        worn=wear_pattern(wear_share, rng),
        bodies=tuple(_surroundings(painter, plan, rng)),
        path=painter.path,
        backdrop=CLASS_IDS["sky"],
        ego=(own_body(),),
    )


def _lamps(painter: Painter, plan: ParkingPlan, rng: np.random.Generator) -> list[MapElement]:
    """A lamp at each end of every island, and some around the lot."""
    (x0, y0), (x1, y1) = plan.low_xy, plan.high_xy
    places = [(x, y) for begin, end, y in plan.backs for x in (begin - 0.6, end + 0.6)]
    step_m = float(rng.uniform(17.0, 24.0))
    for x in np.arange(x0 + 4.0, x1, step_m).tolist():
        places += [(x, y0 - 1.0), (x, y1 + 1.0)]
    return [
        make.pole(f"lamp_{k}", painter.place(x, y), _LAMP_M, 0.095, 0.065, "lamp_post")
        for k, (x, y) in enumerate(places)
    ]


def _surroundings(painter: Painter, plan: ParkingPlan, rng: np.random.Generator) -> list[Solid]:
    """Trees behind the sidewalk all around, and houses on one side."""
    (x0, y0), (x1, y1) = plan.low_xy, plan.high_xy
    beyond_m = _SIDEWALK_M + 2.6
    across = np.arange(x0, x1, float(rng.uniform(9.0, 14.0))).tolist()
    upward = np.arange(y0, y1, float(rng.uniform(9.0, 14.0))).tolist()
    places = [(x, y) for x in across for y in (y0 - beyond_m, y1 + beyond_m)]
    places += [(x1 + beyond_m, y) for y in upward]
    solids: list[Solid] = []
    for x, y in places:
        crown, exists = float(rng.uniform(1.3, 2.2)), rng.random() < 0.75
        base = painter.place(x + float(rng.uniform(-1.0, 1.0)), y)
        if exists:
            solids += tree(base, crown, 2.8)
    for x in np.arange(x0 + 8.0, x1, 24.0).tolist():
        height_m = float(rng.uniform(6.0, 14.0))
        base = painter.place(x, y1 + beyond_m + 12.0)
        size = (float(rng.uniform(13.0, 20.0)), 11.0, height_m)
        solids.append(house(base, np.eye(3), size, rng.uniform(0.35, 0.75)))
    return solids
