"""What stands up in a top view: drawn out away from the camera that sees it (room: simulation; host).

In: a random generator. Out: where the own car is, wedges along lines of sight, cones, posts, pillars as ColouredArea.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.simulation.top_views.clutter import ColouredArea

_CAR_M = ((4.0, 5.0), (1.7, 2.0))
_VIEW_M = 10.0
"""Side of the whole view that a crop is cut from: the car stands in its middle."""
_SIGNALS = np.array([[0.1, 0.4, 0.95], [0.1, 0.8, 0.95], [0.2, 0.2, 0.8], [0.9, 0.9, 0.9], [0.05, 0.05, 0.05]])
"""Colours of cones, posts and bumps, blue green red: orange, yellow, red, white, black."""


class OwnCar(NamedTuple):
    """The car that carries the cameras.

    Attributes:
        middle_m: float64[2], from the upper left corner of the picture.
        size_m: float64[2], along u and v.
        heading_rad: 0 where it runs along v, else pi / 2.
    """

    middle_m: Float[np.ndarray, " 2"]
    size_m: Float[np.ndarray, " 2"]
    heading_rad: float


def own_car(rng: np.random.Generator, size_m: float) -> OwnCar:
    """A car near the middle of the view that a picture of this side is cut from."""
    middle = size_m * 0.5 + rng.uniform(-0.5, 0.5, 2) * max(_VIEW_M - size_m, 0.5)
    heading = float(rng.choice([0.0, 0.5 * np.pi]))
    size = np.array([rng.uniform(*_CAR_M[1]), rng.uniform(*_CAR_M[0])])
    return OwnCar(middle, size if heading == 0.0 else size[::-1], heading)


def wedge(
    rng: np.random.Generator, car: OwnCar, size_m: float, wide_m: float, long_m: float
) -> Float[np.ndarray, "4 2"]:
    """An area that begins somewhere on the road and runs away from the nearest camera, ever wider.

    Args:
        rng: where it begins.
        car: whose cameras are in the middle of its four sides.
        size_m: side of the picture.
        wide_m: where it begins.
        long_m: its length.
    """
    foot = size_m * rng.random(2)
    sides = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
    cameras = car.middle_m + sides * car.size_m
    camera = cameras[np.linalg.norm(cameras - foot, axis=1).argmin()]
    away_m = max(float(np.linalg.norm(foot - camera)), 0.3)
    sight = (foot - camera) / away_m
    aside = 0.5 * wide_m * np.array([-sight[1], sight[0]])
    end, grown = foot + long_m * sight, 1.0 + long_m / away_m
    return np.array([foot - aside, foot + aside, end + grown * aside, end - grown * aside])


def drawn_out(rng: np.random.Generator, car: OwnCar, size_m: float) -> list[ColouredArea]:
    """Cones, posts and pillars, plain or striped, and a striped bump across the way."""
    found: list[ColouredArea] = []
    if rng.random() < 0.35:
        for _ in range(int(rng.integers(1, 6))):
            found += _standing(rng, car, size_m)
    if rng.random() < 0.15:
        found += _bump(rng, car, size_m)
    return found


def _standing(rng: np.random.Generator, car: OwnCar, size_m: float) -> list[ColouredArea]:
    """One thing that stands up, in bands or in stripes along it."""
    outline = wedge(rng, car, size_m, rng.uniform(0.08, 0.7), rng.uniform(0.3, 5.0))
    colours = _SIGNALS[rng.choice(len(_SIGNALS), 2, replace=False)] * rng.uniform(0.5, 1.0)
    if rng.random() < 0.3:
        colours = np.tile(np.full(3, rng.uniform(0.2, 0.8)), (2, 1))
    num, is_along = int(rng.integers(1, 7)), bool(rng.random() < 0.4)
    cuts, parts = np.linspace(0.0, 1.0, num + 1), []
    a, b, c, d = outline
    for k in range(num):
        low, high = cuts[k], cuts[k + 1]
        if is_along:
            part = [a + low * (b - a), a + high * (b - a), d + high * (c - d), d + low * (c - d)]
        else:
            part = [a + low * (d - a), b + low * (c - b), b + high * (c - b), a + high * (d - a)]
        parts.append(ColouredArea(np.array(part), colours[k % 2]))
    return parts


def _bump(rng: np.random.Generator, car: OwnCar, size_m: float) -> list[ColouredArea]:
    """A speed bump in stripes across the way of the car."""
    across = np.array([1.0, 0.0]) if car.heading_rad == 0.0 else np.array([0.0, 1.0])
    ahead = across[::-1]
    start = car.middle_m - rng.uniform(1.5, 5.0) * across + rng.uniform(-0.5, 0.5) * size_m * ahead
    wide, step_m, num = rng.uniform(0.25, 0.5) * ahead, rng.uniform(0.2, 0.5), int(rng.integers(6, 24))
    bright = _SIGNALS[int(rng.choice([1, 3]))]
    stripes = []
    for k in range(num):
        a, b = start + k * step_m * across, start + (k + 1) * step_m * across
        stripes.append(ColouredArea(np.array([a, b, b + wide, a + wide]), bright if k % 2 else np.full(3, 0.05)))
    return stripes
