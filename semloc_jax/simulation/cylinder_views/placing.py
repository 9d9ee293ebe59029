"""Where things stand in a random view: alone, beside each other, in slots, none in another (room: simulation; host).

In: a random generator, how wide the view is. Out: Body list and the painted slots.
"""

import numpy as np
from jaxtyping import Float

from semloc_jax.simulation.cylinder_views.bodies import Body
from semloc_jax.simulation.cylinder_views.bystanders import bystander
from semloc_jax.simulation.cylinder_views.cars import car
from semloc_jax.simulation.cylinder_views.kept_free import obstacle
from semloc_jax.simulation.top_views.slot_layout import Layout, random_layout

KINDS = ("cone", "pillar", "ground_lock", "no_parking_sign")
_SHARES = (0.26, 0.12, 0.29, 0.33)
RANGE_M = (0.8, 12.0)
"""Of what stands alone."""
_CAR_M = (2.8, 10.0)
"""Of the middle of a car that stands in no slot."""
_IN_LINE = 0.35
"""Of the things beside others, those that stand before them, as cones before signs do."""
_HIDES = 0.6
"""Of the nearest range of what is low: pillars and bystanders stand from here on."""
_FAR_SHARE = 0.5
"""Of the things, as many on each metre of the range; of the others as many near as far by its logarithm."""
SIZE_M = 16.0
"""Least side of the square with painted slots around the car."""
_AT_ONCE = 60
"""Most things in one picture: their numbers are those in `Canvas.ids`."""


def placed(
    rng: np.random.Generator,
    half_rad: float,
    ceiling_m: float | None,
    low_m: tuple[float, float] = RANGE_M,
    size_m: float = SIZE_M,
) -> tuple[list[Body], Layout]:
    """Things at random places, none in another, and the painted slots, some with cars.

    Args:
        rng: all that is random.
        half_rad: half of the width of the view.
        ceiling_m: of the hall; None outside.
        low_m: range of what is low.
        size_m: side of the square with painted slots.
    """
    layout = random_layout(rng, size_m)
    # What stands before all that has to be found hides it: some does, but not most.
    any_m = (max(_HIDES * low_m[0], RANGE_M[0]), RANGE_M[1])
    bodies: list[Body] = []

    def add(body: Body, gap_m: float) -> None:
        reach = [np.linalg.norm(b.footprint - b.middle, axis=1).max() for b in (*bodies, body)]
        away = [float(np.linalg.norm(b.middle - body.middle)) for b in bodies]
        nearest = float(np.linalg.norm(body.footprint, axis=1).min())
        if (
            nearest > 0.55
            and len(bodies) < _AT_ONCE
            and all(a > 0.75 * r + gap_m for a, r in zip(away, reach[:-1], strict=True))
        ):
            bodies.append(body)

    same_look = int(rng.integers(2**32))
    for _ in range(int(rng.integers(1, 6)) if ceiling_m is not None else 0):
        # Pillars of one hall look alike.
        add(obstacle(np.random.default_rng(same_look), "pillar", _place(rng, half_rad, any_m), ceiling_m), 0.25)
    # On real lots few things stand, and cars beside them look like some.
    for _ in range(int(rng.integers(0, rng.choice([6, 16])))):
        kind = str(rng.choice(KINDS, p=_SHARES))
        place = _place(rng, half_rad, any_m if kind == "pillar" else low_m)
        add(obstacle(rng, kind, place, ceiling_m), 0.25)
    full = rng.choice([0.0, 0.3, 0.8], p=(0.1, 0.35, 0.55))
    for slot in layout.slots:
        middle = slot.mean(axis=0) - 0.5 * size_m
        if rng.random() < full and 2.6 < np.linalg.norm(middle) < 16.0:
            long_side = slot[3] - slot[0]
            if np.linalg.norm(slot[1] - slot[0]) > np.linalg.norm(long_side):
                long_side = slot[1] - slot[0]
            turned = float(np.arctan2(long_side[1], long_side[0])) + np.pi * rng.integers(2)
            add(car(rng, middle, turned), 0.6)
    if rng.random() < 0.5:
        # Tyres and lamps look like signs where a strip shows them as near as this.
        place = _place(rng, half_rad, _CAR_M)
        add(car(rng, place, rng.uniform(-np.pi, np.pi)), 0.9)
    for _ in range(int(rng.integers(0, 8)) if bodies else 0):
        # Cones stand around signs, locks before bumpers: one hides the other, or is behind it.
        near = bodies[int(rng.integers(len(bodies)))]
        place = _beside(rng, near)
        if np.linalg.norm(place) < RANGE_M[1]:
            add(obstacle(rng, str(rng.choice(KINDS, p=_SHARES)), place, ceiling_m), 0.15)
    for _ in range(int(rng.integers(0, 6))):
        add(bystander(rng, _place(rng, half_rad, any_m)), 0.3)
    return bodies, layout


def _place(rng: np.random.Generator, half_rad: float, limits_m: tuple[float, float]) -> Float[np.ndarray, " 2"]:
    """Ahead or aside, at any range."""
    is_far = rng.random() < _FAR_SHARE
    range_m = float(rng.uniform(*limits_m) if is_far else np.exp(rng.uniform(*np.log(limits_m))))
    phi = rng.uniform(-1.1, 1.1) * half_rad
    return range_m * np.array([np.sin(phi), np.cos(phi)])


def _beside(rng: np.random.Generator, body: Body) -> Float[np.ndarray, " 2"]:
    """A place around a thing, less than a metre from the circle about its footprint; some hide a part of it."""
    reach_m, phi = np.linalg.norm(body.footprint - body.middle, axis=1).max(), rng.uniform(-np.pi, np.pi)
    if rng.random() < _IN_LINE:
        phi = float(np.arctan2(*-body.middle)) + rng.normal(scale=0.35)
    away_m = rng.uniform(0.8, 1.1) * reach_m + rng.uniform(0.1, 0.8)
    return body.middle + away_m * np.array([np.sin(phi), np.cos(phi)])
