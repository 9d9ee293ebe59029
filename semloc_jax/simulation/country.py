"""A simulated country road: two lanes, edge lines, dashes, delineator posts, a crown, and nothing else to go by (room:
simulation; host).

In: a random generator, the length to drive. Out: World.
"""

import numpy as np

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import MapElement
from semloc_jax.simulation import elements as make
from semloc_jax.simulation.crown import CrownedSurface
from semloc_jax.simulation.elements import Painter
from semloc_jax.simulation.paint import GroundArea, wear_pattern
from semloc_jax.simulation.path import winding_path
from semloc_jax.simulation.scene import World
from semloc_jax.simulation.solids import Solid, tree
from semloc_jax.simulation.surface import rolling_surface

LANE_M = 3.0
_BEHIND_M, _AHEAD_M = 40.0, 160.0
_POSTS_M = 50.0
_VERGE_M = 1.0
_DASH_AND_GAP_M = 4.0, 8.0
_STUD_AND_GAP_M = 0.3, 0.9
_STUDS_M = 0.5


def build_country_road(
    rng: np.random.Generator, length_m: float, wear_share: float, crown: float, has_studs: bool = False
) -> World:
    """A road of two lanes whose right one the vehicle drives from s = 0 to s = `length_m`.

    Lateral offsets d are from the middle of that lane: the right edge line at -1.5, the dashes on the crown at 1.5, the
    left edge line at 4.5, studs half a metre beside it.

    Args:
        rng: everything random follows from it.
        length_m: way to drive.
        wear_share: share of the paint that is worn off.
        crown: share by which the road falls to both sides.
        has_studs: whether there are studs.
    """
    start, end = -_BEHIND_M, length_m + _AHEAD_M
    path = winding_path(rng, start - 60.0, end + 60.0, start_heading_rad=rng.uniform(-np.pi, np.pi))
    ground = rolling_surface(rng, camber=0.0)
    painter = Painter(path, CrownedSurface.along(ground, path, 0.5 * LANE_M, crown, LANE_M + _VERGE_M))
    elements = [
        painter.line("edge_right", "lane_solid", -0.5 * LANE_M, start, end, 0.12),
        painter.line("edge_left", "lane_solid", 1.5 * LANE_M, start, end, 0.12),
        *painter.dashes("dash", 0.5 * LANE_M, start + rng.uniform(0.0, sum(_DASH_AND_GAP_M)), end, *_DASH_AND_GAP_M),
        *_posts(painter, rng, start, end),
    ]
    if has_studs:
        elements += painter.dashes("stud", 1.5 * LANE_M - _STUDS_M, start, end, *_STUD_AND_GAP_M)
    areas = (_asphalt(painter, start, end),)
    worn = wear_pattern(wear_share, rng)
    trees = tuple(_trees(painter, rng, start, end))
    rest, sky = CLASS_IDS["terrain"], CLASS_IDS["sky"]
    return World(tuple(elements), painter.surface, areas, rest, worn, path, sky, trees)


def _posts(painter: Painter, rng: np.random.Generator, start: float, end: float) -> list[MapElement]:
    """Delineator posts on both sides, not at one pace: where one stands tells which dash is which."""
    posts = []
    for side, d in (("right", -0.5 * LANE_M - _VERGE_M), ("left", 1.5 * LANE_M + _VERGE_M)):
        places = np.arange(start, end, _POSTS_M)
        for number, s in enumerate(places + rng.uniform(-2.0, 2.0, len(places))):
            base = painter.place(float(s), d)
            posts.append(make.pole(f"post_{side}_{number}", base, 1.0, 0.06, 0.06, "delineator"))
    return posts


def _asphalt(painter: Painter, start: float, end: float) -> GroundArea:
    s = np.arange(start - 50.0, end + 50.0, 1.0)
    right, left = painter.path.at(s, -0.5 * LANE_M - 0.3), painter.path.at(s, 1.5 * LANE_M + 0.3)
    return GroundArea(CLASS_IDS["road"], np.vstack([right, left[::-1]]))


def _trees(painter: Painter, rng: np.random.Generator, start: float, end: float) -> list[Solid]:
    """Trees on both sides, which no map knows."""
    solids: list[Solid] = []
    for d in (-0.5 * LANE_M - 6.0, 1.5 * LANE_M + 6.0):
        for s in np.arange(start, end, 17.0):
            base = painter.place(float(s + rng.uniform(-6.0, 6.0)), d + float(np.sign(d) * rng.uniform(0.0, 4.0)))
            solids += tree(base, rng.uniform(1.5, 3.0), 3.6, (4.0, 0.2, 0.15))
    return solids
