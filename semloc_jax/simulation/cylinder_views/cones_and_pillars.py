"""Cones and pillars in all their looks, and the colours of what warns (room: simulation; host).

In: a random generator, a place. Out: Body with parts and footprint.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Float

from semloc_jax.simulation.cylinder_views.bodies import (
    UNIT,
    Band,
    Body,
    Patch,
    RoundPart,
    box,
    rectangle,
    stripes,
)
from semloc_jax.simulation.cylinder_views.canvas import Colour

YELLOW, RED, ORANGE = np.array([0.08, 0.72, 0.92]), np.array([0.12, 0.1, 0.75]), np.array([0.08, 0.33, 0.95])
ROUND = np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0.0, 2.0 * np.pi, 17)[:-1]])
"""Places of a circle of radius 1."""
BLACK, WHITE, BLUE = np.full(3, 0.05), np.full(3, 0.92), np.array([0.7, 0.3, 0.1])


def varied(rng: np.random.Generator, colour: Colour, by: float = 0.12) -> Colour:
    """The colour, faded, dirty or otherwise mixed."""
    level = rng.uniform(1.0 - 2.0 * by, 1.0 + by)
    faded = colour + rng.uniform(0.0, 2.0 * by) * (colour.mean() - colour)
    return np.clip(level * faded + 0.3 * by * rng.standard_normal(3), 0.02, 1.0)


def any_colour(rng: np.random.Generator) -> Colour:
    """Grey mostly, seldom strong."""
    grey = rng.uniform(0.04, 0.95)
    strong = rng.random(3) if rng.random() < 0.45 else np.full(3, grey)
    return np.clip(0.6 * strong + 0.4 * grey, 0.03, 1.0)


def cone(rng: np.random.Generator, middle: Float[np.ndarray, " 2"]) -> Body:
    """A traffic cone of any size on its plate, with up to three bands."""
    high_m = rng.uniform(0.42, 1.0)
    side_m = high_m * rng.uniform(0.42, 0.62)
    plate_m = rng.uniform(0.02, 0.05)
    colour = varied(rng, (ORANGE, RED, YELLOW, np.array([0.2, 0.75, 0.45]))[rng.choice(4, p=(0.68, 0.22, 0.07, 0.03))])
    radius_m, tip_m = 0.5 * side_m * rng.uniform(0.68, 0.92), rng.uniform(0.02, 0.045)
    edges, colours = [plate_m], []
    for k in range(int(rng.choice(4, p=(0.2, 0.45, 0.3, 0.05)))):
        start = rng.uniform(0.28, 0.45) if k == 0 else edges[-1] / high_m + rng.uniform(0.08, 0.16)
        edges += [start * high_m, (start + rng.uniform(0.1, 0.24)) * high_m]
        colours += [colour, varied(rng, WHITE)]
    edges = [e for e in edges if e < 0.93 * high_m]
    edges.append(high_m)
    colours = (colours + [colour] * len(edges))[: len(edges) - 1]

    def radius(at_m: float) -> float:
        return radius_m + (tip_m - radius_m) * (at_m - plate_m) / (high_m - plate_m)

    bands = [Band(a, b, radius(a), radius(b), c) for (a, b), c in zip(pairwise(edges), colours, strict=True)]
    yaw = rng.uniform(-np.pi, np.pi)
    base = varied(rng, BLACK) if rng.random() < 0.4 else colour
    parts = [box(middle, (side_m, side_m), yaw, 0.0, plate_m, base), RoundPart(middle, tuple(bands))]
    return Body(middle, middle + rectangle((side_m, side_m), yaw), high_m, parts=parts)


def pillar(rng: np.random.Generator, middle: Float[np.ndarray, " 2"], high_m: float) -> Body:
    """A square, oblong or round pillar, striped or painted below or not."""
    wide_m, yaw = rng.uniform(0.25, 1.0), rng.uniform(-np.pi, np.pi)
    colour = varied(rng, np.full(3, rng.uniform(0.35, 0.95)), 0.06)
    if rng.random() < 0.07:
        colour = varied(rng, (YELLOW, RED, BLUE, np.array([0.35, 0.6, 0.3]))[int(rng.integers(4))])
    to_m = rng.uniform(0.5, 1.5)
    if rng.random() < 0.25:
        radius_m = 0.5 * wide_m
        bands = [Band(0.0, to_m, radius_m, radius_m, _lower_colour(rng, colour))]
        if rng.random() < 0.5:
            edges = np.linspace(0.0, to_m, int(rng.integers(3, 8)))
            two = signal(rng)
            bands = [Band(a, b, radius_m, radius_m, two[k % 2]) for k, (a, b) in enumerate(pairwise(edges))]
        bands.append(Band(to_m, high_m, radius_m, radius_m, colour))
        circle = middle + radius_m * ROUND
        return Body(middle, circle, high_m, parts=[RoundPart(middle, tuple(bands))])
    size = (wide_m, wide_m * rng.uniform(0.6, 1.6) if rng.random() < 0.4 else wide_m)
    patches: tuple[Patch, ...] = ()
    draw, share = rng.random(), to_m / high_m
    if draw < 0.6:
        patches = stripes(
            signal(rng),
            int(rng.integers(4, 14)),
            share * rng.uniform(0.4, 1.2) * rng.choice([-1, 1]),
            rng.uniform(0.0, 0.04),
            share,
        )
    elif draw < 0.85:
        patches = (Patch(UNIT * [1.0, share], _lower_colour(rng, colour)),)
    if rng.random() < 0.35:
        at = rng.uniform(share, 0.8)
        sign = np.array([0.15, at]) + UNIT * [0.7, rng.uniform(0.05, 0.2)]
        patches = (*patches, Patch(sign, varied(rng, (BLUE, WHITE, RED, BLACK)[int(rng.integers(4))])))
    parts = [box(middle, size, yaw, 0.0, high_m, colour, (patches,) * 4)]
    if rng.random() < 0.2:
        plinth = (size[0] + 0.08, size[1] + 0.08)
        parts.append(box(middle, plinth, yaw, 0.0, rng.uniform(0.06, 0.3), varied(rng, np.full(3, 0.5))))
    return Body(middle, middle + rectangle(size, yaw), high_m, parts=parts)


def _lower_colour(rng: np.random.Generator, colour: Colour) -> Colour:
    others = (YELLOW, RED, np.full(3, 0.3), BLUE, np.array([0.4, 0.6, 0.3]), colour)
    return varied(rng, others[int(rng.integers(6))])


def signal(rng: np.random.Generator) -> tuple[Colour, Colour]:
    """Two colours that warn."""
    pairs = ((YELLOW, BLACK), (RED, WHITE), (YELLOW, RED), (BLUE, WHITE))
    one, two = pairs[rng.choice(4, p=(0.68, 0.24, 0.04, 0.04))]
    return varied(rng, one), varied(rng, two)
