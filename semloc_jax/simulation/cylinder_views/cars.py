"""Cars that stand on parking lots: hull with lamps around its corners, cabin, wheels (room: simulation; host).

In: a random generator, a place. Out: Body.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.simulation.cylinder_views.bodies import UNIT, Body, BoxPart, Part, Patch, box, rectangle
from semloc_jax.simulation.cylinder_views.canvas import Canvas, Colour
from semloc_jax.simulation.cylinder_views.cones_and_pillars import BLACK, BLUE, RED, WHITE, YELLOW, any_colour, varied

_WHEEL = np.linspace(0.0, 2.0 * np.pi, 13)[:-1]
_COVERED_SHARE = 0.2
"""Of the cars: under a cover, or trailers and skips, without lamps, windows and wheels."""
_LIT_SHARE = 0.3
"""Of the cars: their lamps outshine everything, and glare."""


def car(rng: np.random.Generator, middle: Float[np.ndarray, " 2"], yaw: float) -> Body:
    """Body, cabin, wheels, lights, plates."""
    size = (rng.uniform(3.6, 4.9), rng.uniform(1.65, 1.95))
    colour = varied(rng, (BLUE, RED, WHITE, np.full(3, 0.3), any_colour(rng))[int(rng.integers(5))])
    low_m, hood_m, roof_m = rng.uniform(0.16, 0.3), rng.uniform(0.75, 1.0), rng.uniform(1.4, 1.95)
    is_covered, sides = bool(rng.random() < _COVERED_SHARE), _sides(rng, colour)
    hull = box(middle, size, yaw, low_m, hood_m, colour, ((), (), (), ()) if is_covered else sides, 0.97)
    ahead, aside = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    glass = varied(rng, np.full(3, rng.uniform(0.05, 0.3)))
    back_m, front_m, top_m = rng.uniform(0.32, 0.48), rng.uniform(0.12, 0.28), rng.uniform(0.55, 0.85)
    ends = np.array([-back_m, front_m, front_m, -back_m]) * size[0]
    half = np.array([-0.48, -0.48, 0.48, 0.48]) * size[1]
    low = middle + ends[:, None] * ahead + half[:, None] * aside
    high = middle + (top_m * ends)[:, None] * ahead + (0.85 * half)[:, None] * aside
    cabin = BoxPart(
        np.column_stack([low, np.full(4, hood_m)]),
        np.column_stack([high, np.full(4, roof_m)]),
        colour,
        (() if is_covered else (Patch(0.08 + 0.84 * UNIT, glass),),) * 4,
    )
    parts: list[Part] = [hull, cabin]
    for along in () if is_covered else (-0.31, 0.31):
        for across in (-0.5, 0.5):
            at = middle + along * size[0] * ahead + 1.01 * across * size[1] * aside
            parts.append(_Wheel(at, ahead * np.sign(-across), rng.uniform(0.28, 0.36), varied(rng, np.full(3, 0.55))))
    return Body(middle, middle + rectangle(size, yaw), roof_m, parts=parts)


class _Lamp(NamedTuple):
    """Of one end of a car."""

    colour: Colour
    size: Float[np.ndarray, " 2"]
    """Shares of width and height of the end."""


def _sides(rng: np.random.Generator, colour: Colour) -> tuple[tuple[Patch, ...], ...]:
    """Lamps, plates and skirts on the right side, the front, the left side and the back of a hull."""
    is_lit = rng.random() < _LIT_SHARE
    head_colour = varied(rng, WHITE if rng.random() < 0.6 else YELLOW)
    head_colour = head_colour * (rng.uniform(1.5, 3.0) if is_lit else rng.uniform(0.7, 1.2))
    lit, dark = np.array([0.3, 0.35, 1.0]), np.array([0.1, 0.1, 1.0])
    tail_colour = lit * rng.uniform(1.0, 2.5) if is_lit else dark * [1.0, 1.0, rng.uniform(0.45, 0.9)]
    skirt = varied(rng, np.full(3, 0.12)) if rng.random() < 0.6 else colour
    plate = varied(rng, (WHITE, YELLOW, BLUE)[rng.choice(3, p=(0.7, 0.15, 0.15))])
    inset, around = rng.choice([0.0, 0.03]), rng.choice([0.0, rng.uniform(0.01, 0.07)])
    low = rng.uniform(0.45, 0.65)
    sizes = [np.array([rng.uniform(0.1, 0.28), rng.uniform(0.12, 0.34)]) for _ in range(2)]
    head, tail = _Lamp(head_colour, sizes[0]), _Lamp(tail_colour, sizes[1])

    def end(lamp: _Lamp) -> tuple[Patch, ...]:
        return (
            Patch(UNIT * [1.0, 0.3], skirt),
            Patch(np.array([inset, low]) + UNIT * lamp.size, lamp.colour),
            Patch(np.array([1.0 - inset - lamp.size[0], low]) + UNIT * lamp.size, lamp.colour),
            Patch(np.array([0.36, 0.3]) + UNIT * [0.28, 0.18], plate),
        )

    def side(first: _Lamp, last: _Lamp) -> tuple[Patch, ...]:
        """Lamps reach around the corners of many cars."""
        corners = (
            Patch(np.array([0.0, low]) + UNIT * [around, first.size[1]], first.colour),
            Patch(np.array([1.0 - around, low]) + UNIT * [around, last.size[1]], last.colour),
        )
        return (Patch(UNIT * [1.0, 0.18], skirt), *(corners if around else ()))

    return side(tail, head), end(head), side(head, tail), end(tail)


class _Wheel(NamedTuple):
    """A tyre with its rim on the side of a car; seen from outside only."""

    middle: Float[np.ndarray, " 2"]
    ahead: Float[np.ndarray, " 2"]
    radius_m: float
    rim: Colour

    def paint(self, canvas: Canvas, thing: int) -> None:
        """Two discs."""
        circle = np.cos(_WHEEL)[:, None] * np.append(self.ahead, 0.0) + np.sin(_WHEEL)[:, None] * [0.0, 0.0, 1.0]
        centre = np.append(self.middle, self.radius_m)
        for share, colour in ((1.0, BLACK), (0.66, self.rim)):
            places = centre + share * self.radius_m * circle
            if canvas.faces_us(places[::-1]):
                canvas.area(places, colour, thing)
