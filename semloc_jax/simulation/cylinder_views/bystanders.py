"""What else stands on parking lots and is none of the four classes (room: simulation; host).

In: a random generator, a place. Out: Body: people, posts, bins, wheel stops, boxes, trees, walls, houses.
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
    Sheet,
    box,
    rectangle,
    stripes,
)
from semloc_jax.simulation.cylinder_views.canvas import Colour
from semloc_jax.simulation.cylinder_views.cones_and_pillars import (
    BLACK,
    BLUE,
    ORANGE,
    RED,
    WHITE,
    YELLOW,
    any_colour,
    varied,
)


def _upright(rng: np.random.Generator, middle: np.ndarray, radius_m: float, high_m: float, *colours: Colour) -> Body:
    edges = np.linspace(0.0, high_m, len(colours) + 1)
    bands = [Band(a, b, radius_m, radius_m, c) for (a, b), c in zip(pairwise(edges), colours, strict=True)]
    return Body(
        middle, middle + rectangle((2 * radius_m, 2 * radius_m), 0.0), high_m, parts=[RoundPart(middle, tuple(bands))]
    )


def _person(rng: np.random.Generator, middle: np.ndarray) -> Body:
    high_m = rng.uniform(1.2, 1.95)
    skin, coat, legs = np.array([0.45, 0.6, 0.8]) * rng.uniform(0.4, 1.2), any_colour(rng), any_colour(rng)
    coat = ORANGE if rng.random() < 0.1 else coat
    bands = (
        Band(0.0, 0.48 * high_m, 0.1, 0.16, legs),
        Band(0.46 * high_m, 0.84 * high_m, 0.2, 0.22, coat),
        Band(0.86 * high_m, high_m, 0.09, 0.07, skin),
    )
    return Body(middle, middle + rectangle((0.4, 0.4), 0.0), high_m, parts=[RoundPart(middle, bands)])


def _post(rng: np.random.Generator, middle: np.ndarray) -> Body:
    """Bollards, lamp posts, poles of signs, trunks."""
    radius_m, high_m = rng.uniform(0.025, 0.13), rng.choice([rng.uniform(0.6, 1.2), rng.uniform(2.0, 6.0)])
    two = (varied(rng, (RED, YELLOW, BLACK, np.full(3, 0.5))[int(rng.integers(4))]), varied(rng, WHITE))
    colours = [two[k % 2] for k in range(int(rng.integers(3, 9)))] if rng.random() < 0.35 else [any_colour(rng)]
    body = _upright(rng, middle, radius_m, float(high_m), *colours)
    if high_m > 2.0 and rng.random() < 0.5:  # a sign high up
        size, yaw = rng.uniform(0.3, 0.7), rng.uniform(-np.pi, np.pi)
        aside = np.append(0.5 * size * np.array([np.cos(yaw), np.sin(yaw)]), 0.0)
        low, top = np.append(middle, high_m - size), np.append(middle, high_m)
        colour = varied(rng, (RED, BLUE, WHITE, YELLOW)[int(rng.integers(4))])
        body.parts.append(
            Sheet(
                np.array([low - aside, low + aside, top + aside, top - aside]),
                colour,
                (Patch(0.2 + 0.6 * UNIT, any_colour(rng)),),
            )
        )
    return body


def _bin(rng: np.random.Generator, middle: np.ndarray) -> Body:
    """Bins, boxes, crates, machines."""
    size = (rng.uniform(0.3, 1.2), rng.uniform(0.3, 0.9))
    high_m, yaw = rng.uniform(0.25, 1.5), rng.uniform(-np.pi, np.pi)
    colour = varied(rng, any_colour(rng))
    spot = (Patch(rng.uniform(0.1, 0.4) + 0.4 * UNIT, any_colour(rng)),)
    lid = box(middle, (1.06 * size[0], 1.06 * size[1]), yaw, 0.92 * high_m, high_m, any_colour(rng))
    parts = [box(middle, size, yaw, 0.0, high_m, colour, (spot if rng.random() < 0.5 else (),) * 4), lid]
    return Body(middle, middle + rectangle(size, yaw), high_m, parts=parts)


def _wheel_stop(rng: np.random.Generator, middle: np.ndarray) -> Body:
    """A low beam, plain or in yellow and black."""
    size, yaw = (rng.uniform(0.1, 0.2), rng.uniform(0.5, 2.0)), rng.uniform(-np.pi, np.pi)
    colours = (varied(rng, (YELLOW, WHITE, RED)[int(rng.integers(3))]), varied(rng, BLACK))
    plain = varied(rng, np.full(3, rng.uniform(0.3, 0.8)))
    is_striped = rng.random() < 0.6
    num = int(rng.integers(2, 7))
    across = tuple(Patch(np.array([k / num, 0.0]) + UNIT * [0.5 / num, 1.0], colours[0]) for k in range(num))
    patches = (across if is_striped else (),) * 4
    beam = box(middle, size, yaw, 0.0, rng.uniform(0.06, 0.15), colours[1] if is_striped else plain, patches, 0.8)
    return Body(middle, middle + rectangle(size, yaw), 0.12, parts=[beam])


def _barrier(rng: np.random.Generator, middle: np.ndarray) -> Body:
    """A rail or fence, striped or not."""
    long_m, high_m, yaw = rng.uniform(1.0, 4.0), rng.uniform(0.6, 1.3), rng.uniform(-np.pi, np.pi)
    aside = np.append(0.5 * long_m * np.array([np.cos(yaw), np.sin(yaw)]), 0.0)
    low, top = np.append(middle, high_m - rng.uniform(0.1, 0.4)), np.append(middle, high_m)
    across = tuple(Patch(np.array([k / 8, 0.0]) + UNIT * [1 / 16, 1.0], varied(rng, RED)) for k in range(8))
    sheet = Sheet(
        np.array([low - aside, low + aside, top + aside, top - aside]),
        varied(rng, WHITE),
        across if rng.random() < 0.5 else (),
    )
    legs = [_upright(rng, middle + s * aside[:2], 0.03, high_m, np.full(3, 0.4)).parts[0] for s in (-0.9, 0.9)]
    return Body(middle, middle + rectangle((long_m, 0.1), yaw), high_m, parts=[*legs, sheet])


def _tree(rng: np.random.Generator, middle: np.ndarray) -> Body:
    trunk = _upright(rng, middle, rng.uniform(0.08, 0.25), 2.4, varied(rng, np.array([0.15, 0.22, 0.3])))
    green, crown_m = np.array([0.12, 0.35, 0.2]) * rng.uniform(0.5, 1.5), rng.uniform(0.8, 2.2)
    for _ in range(5):
        at = middle + 0.4 * crown_m * rng.standard_normal(2)
        base = rng.uniform(1.6, 3.2)
        lobe = (
            Band(base, base + 0.7 * crown_m, 0.5 * crown_m, 0.7 * crown_m, varied(rng, green)),
            Band(base + 0.7 * crown_m, base + 1.3 * crown_m, 0.7 * crown_m, 0.2 * crown_m, green),
        )
        trunk.parts.append(RoundPart(at, lobe))
    return trunk


_OTHERS = (_person, _post, _bin, _wheel_stop, _barrier, _tree)
_SHARES = (0.2, 0.26, 0.2, 0.18, 0.08, 0.08)


def bystander(rng: np.random.Generator, middle: Float[np.ndarray, " 2"]) -> Body:
    """Any of them but cars."""
    return _OTHERS[rng.choice(len(_OTHERS), p=_SHARES)](rng, middle)


def background(rng: np.random.Generator, ceiling_m: float | None) -> list[Body]:
    """Walls and beams of a hall, or houses far off, with windows, bands and pipes."""
    found, is_hall = [], ceiling_m is not None
    for _ in range(int(rng.integers(1, 4)) if is_hall else int(rng.integers(0, 5))):
        size = (rng.uniform(0.3, 4.0), rng.uniform(8.0, 30.0))
        high_m = ceiling_m if is_hall else rng.uniform(3.0, 18.0)
        colour = varied(rng, np.full(3, rng.uniform(0.3, 0.9))) if is_hall else varied(rng, any_colour(rng))
        patches = _bands(rng) if is_hall else _windows(rng)
        away_m = rng.uniform(5.0, 18.0) if is_hall else rng.uniform(14.0, 60.0)
        found.append(_across(rng, away_m, size, (0.0, high_m), colour, patches))
    for _ in range(int(rng.integers(0, 4)) if is_hall else 0):
        deep_m, colour = rng.uniform(0.1, 0.6), varied(rng, np.full(3, rng.uniform(0.2, 0.9)))
        colour = varied(rng, RED) if rng.random() < 0.15 else colour
        found.append(_across(rng, rng.uniform(2.0, 12.0), (0.3, 30.0), (ceiling_m - deep_m, ceiling_m), colour, ()))
    return found


def _across(
    rng: np.random.Generator,
    away_m: float,
    size_m: tuple[float, float],
    heights_m: tuple[float, float],
    colour: Colour,
    patches: tuple[Patch, ...],
) -> Body:
    """A long box across the view, so far away."""
    bearing = rng.uniform(-2.0, 2.0)
    middle = away_m * np.array([np.sin(bearing), np.cos(bearing)])
    yaw = -bearing + 0.5 * np.pi + rng.normal(0.0, 0.2)
    part = box(middle, size_m, yaw, *heights_m, colour, (patches,) * 4)
    return Body(middle, middle + rectangle(size_m, yaw), heights_m[1], parts=[part])


def _bands(rng: np.random.Generator) -> tuple[Patch, ...]:
    found = []
    for _ in range(int(rng.integers(0, 4))):
        low = rng.uniform(0.0, 0.9)
        found.append(Patch(np.array([0.0, low]) + UNIT * [1.0, rng.uniform(0.02, 0.2)], any_colour(rng)))
    if rng.random() < 0.25:
        found += stripes((varied(rng, YELLOW), varied(rng, BLACK)), int(rng.integers(20, 60)), 0.1, 0.0, 0.15)
    for _ in range(int(rng.integers(0, 4))):
        at = np.array([rng.uniform(0.0, 0.9), rng.uniform(0.0, 0.6)])
        found.append(Patch(at + UNIT * [rng.uniform(0.01, 0.08), rng.uniform(0.1, 0.6)], any_colour(rng)))
    return tuple(found)


def _windows(rng: np.random.Generator) -> tuple[Patch, ...]:
    columns, rows = int(rng.integers(4, 12)), int(rng.integers(1, 6))
    colour = any_colour(rng) * 0.5
    return tuple(
        Patch(np.array([(k + 0.2) / columns, (j + 0.3) / rows]) + UNIT * [0.6 / columns, 0.5 / rows], colour)
        for k in range(columns)
        for j in range(rows)
    )
