"""Ground locks and no-parking signs in all their looks, and any of the four classes (room: simulation; host).

In: a random generator, a place. Out: Body with parts, footprint, class.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.geometry.polyline import arc_length
from semloc_jax.simulation.cylinder_views.bodies import (
    UNIT,
    Band,
    Bar,
    Body,
    Part,
    Patch,
    RoundPart,
    Sheet,
    box,
    rectangle,
)
from semloc_jax.simulation.cylinder_views.canvas import Canvas, Colour
from semloc_jax.simulation.cylinder_views.cones_and_pillars import (
    BLACK,
    BLUE,
    RED,
    ROUND,
    WHITE,
    YELLOW,
    cone,
    pillar,
    signal,
    varied,
)

_CIRCLE = 0.5 + 0.5 * ROUND
_ONE_PIECE = 0.5
"""Share of folding boards whose inside has the colour of the outside."""
_LOWERED = 0.35
"""Share of ground locks that lie flat on their foot."""
_BARE = 0.6
"""Of these, bare slabs without a case, as dark or as grey as the road: only their sides tell them from it."""
_PLAIN = 0.4
"""Share of boards that show no writing: faded, or too far off for it."""


def obstacle(
    rng: np.random.Generator, kind: str, middle: Float[np.ndarray, " 2"], ceiling_m: float | None = None
) -> Body:
    """A thing of a class, its middle at a place; pillars reach the ceiling where there is one."""
    if kind == "pillar":
        body = pillar(rng, middle, float(rng.uniform(2.2, 4.5)) if ceiling_m is None else ceiling_m)
    else:
        body = _MAKES[kind](rng, middle)
    body.kind = kind
    return body


def _ground_lock(rng: np.random.Generator, middle: np.ndarray) -> Body:
    is_slim = rng.random() < 0.75  # a tube over a flat foot, as most are
    wide_m, high_m = rng.uniform(0.35, 0.7), rng.uniform(0.24, 0.5)
    long_m = rng.uniform(0.1, 0.22) if is_slim else rng.uniform(0.2, 0.4)
    yaw, two = rng.uniform(-np.pi, np.pi), signal(rng)
    base = varied(rng, (BLACK, np.full(3, 0.3), two[0])[rng.choice(3, p=(0.5, 0.3, 0.2))])
    is_lowered = bool(rng.random() < _LOWERED)
    is_bare = is_lowered and rng.random() < _BARE
    if is_bare:
        base = varied(rng, np.full(3, rng.uniform(0.08, 0.45)))
    # An arm that is folded in makes the foot thicker.
    foot_m = rng.uniform(0.03, 0.07) if is_slim and not is_lowered else rng.uniform(0.05, 0.13)
    foot = box(middle, (long_m, wide_m), yaw, 0.0, foot_m, base)
    body = Body(middle, middle + rectangle((long_m, wide_m), yaw), high_m, parts=[foot])
    ahead, aside = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    if not is_bare and rng.random() < 0.6:
        case = (rng.uniform(0.1, 0.9) * long_m, rng.uniform(0.12, 0.3))
        colour = varied(rng, (YELLOW, BLACK, np.full(3, 0.4), WHITE)[rng.choice(4, p=(0.5, 0.2, 0.2, 0.1))])
        body.parts.append(box(middle, case, yaw, foot_m, foot_m + rng.uniform(0.03, 0.1), colour))
    if is_lowered:
        body.height_m = 0.14
        return body
    lean = rng.uniform(-0.35, 0.35) * high_m * ahead
    wave = _arm(rng, wide_m - 0.05, foot_m, high_m)
    places = np.column_stack([middle + wave[:, :1] * aside + (wave[:, 1:] / high_m) * lean, wave[:, 1]])
    colours = two if rng.random() < 0.75 else (two[0],)
    arm = Bar(places, rng.uniform(0.035, 0.085), colours)
    # The arm stands over the middle of the foot: it hides it, seen from above and from ahead alike.
    body.parts.append(arm)
    if rng.random() < 0.15:
        plate = np.column_stack([middle + np.array([[-0.14], [0.14], [0.14], [-0.14]]) * aside, [0.1, 0.1, 0.3, 0.3]])
        body.parts.append(Sheet(plate, two[0], (Patch(0.2 + 0.6 * UNIT, two[1]),)))
    return body


def _arm(rng: np.random.Generator, wide_m: float, low_m: float, high_m: float) -> Float[np.ndarray, "n 2"]:
    """Sideways and upward along the bar of a lock: an arch, a gate, a trapezium, a triangle, an M, a single post."""
    half = 0.5 * wide_m
    shapes = {
        "arch": np.array([[half * np.cos(a), low_m + (high_m - low_m) * np.sin(a)] for a in np.linspace(np.pi, 0, 12)]),
        "gate": np.array([[-half, low_m], [-half, high_m], [half, high_m], [half, low_m]]),
        "trapezium": np.array([[-half, low_m], [-0.62 * half, high_m], [0.62 * half, high_m], [half, low_m]]),
        "triangle": np.array([[-half, low_m], [0.0, high_m], [half, low_m]]),
        "m": np.array([[-half, low_m], [-0.7 * half, high_m], [0, 0.55 * high_m], [0.7 * half, high_m], [half, low_m]]),
        "post": np.array([[0.0, low_m], [0.0, high_m]]),
    }
    name = str(rng.choice(list(shapes), p=(0.28, 0.22, 0.26, 0.08, 0.1, 0.06)))
    corners = shapes[name]
    s = arc_length(corners)
    at = np.linspace(0.0, s[-1], int(np.ceil(s[-1] / rng.uniform(0.05, 0.14))) + 1)
    # The corners themselves stay, so that a gate is one.
    at = np.unique(np.concatenate([at, s]))
    return np.column_stack([np.interp(at, s, corners[:, axis]) for axis in range(2)])


def _sign(rng: np.random.Generator, middle: np.ndarray) -> Body:
    return (_a_frame if rng.random() < 0.6 else _disc_on_post)(rng, middle)


def _a_frame(rng: np.random.Generator, middle: np.ndarray) -> Body:
    """Two boards that lean against each other."""
    wide_m, high_m, deep_m = rng.uniform(0.28, 0.6), rng.uniform(0.5, 1.05), rng.uniform(0.22, 0.5)
    yaw, colour = rng.uniform(-np.pi, np.pi), _board_colour(rng)
    patches, flat = _writing(rng, colour), rectangle((deep_m, wide_m), yaw)
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    top = flat + np.array([[0.5], [-0.5], [-0.5], [0.5]]) * deep_m * 0.94 * ahead
    low_m = rng.uniform(0.0, 0.12) if rng.random() < 0.4 else 0.0
    low, high = np.column_stack([middle + flat, np.full(4, low_m)]), np.column_stack([middle + top, np.full(4, high_m)])
    back, front = np.array([low[3], low[0], high[0], high[3]]), np.array([low[1], low[2], high[2], high[1]])
    # Folding boards are one piece of plastic, or metal that is painted outside.
    inner = colour if rng.random() < _ONE_PIECE else varied(rng, np.full(3, rng.uniform(0.2, 0.8)))
    far, near = (
        (back, front)
        if np.linalg.norm(back[:2, :2].mean(axis=0)) > np.linalg.norm(front[:2, :2].mean(axis=0))
        else (front, back)
    )
    parts: list[Part] = [Sheet(far, inner), Sheet(near, colour, patches)]
    for corner in (*low,) if low_m else ():
        parts.insert(0, Bar(np.array([corner * [1, 1, 0], corner]), 0.03, (inner,)))
    return Body(middle, middle + flat, high_m, parts=parts)


def _disc_on_post(rng: np.random.Generator, middle: np.ndarray) -> Body:
    """A round or square sign on a post with a heavy foot."""
    high_m, size_m, yaw = rng.uniform(0.65, 1.3), rng.uniform(0.25, 0.45), rng.uniform(-np.pi, np.pi)
    radius_m = rng.uniform(0.14, 0.25)
    foot = RoundPart(middle, (Band(0.0, rng.uniform(0.04, 0.12), radius_m, 0.9 * radius_m, varied(rng, BLACK)),))
    post_colours = signal(rng) if rng.random() < 0.4 else (varied(rng, np.full(3, rng.uniform(0.2, 0.8))),)
    ends = np.column_stack([np.tile(middle, (6, 1)), np.linspace(0.03, high_m, 6)])
    aside = np.append(0.5 * size_m * np.array([-np.sin(yaw), np.cos(yaw)]), 0.0)
    low, high = np.append(middle, high_m - size_m), np.append(middle, high_m)
    corners = np.array([low - aside, low + aside, high + aside, high - aside])
    ring, inside = varied(rng, RED), varied(rng, (WHITE, RED, BLUE)[rng.choice(3, p=(0.3, 0.45, 0.25))])
    sign: list[Patch] = [Patch(_CIRCLE, ring), Patch(0.5 + 0.78 * (_CIRCLE - 0.5), inside)]
    bar = np.array([[0.18, 0.42], [0.82, 0.42], [0.82, 0.58], [0.18, 0.58]])
    if rng.random() < 0.5:
        bar = 0.5 + (bar - 0.5) @ np.array([[0.7, -0.7], [0.7, 0.7]])
    sign.append(Patch(bar, WHITE if inside[2] > 0.5 and inside[0] < 0.5 else ring))
    post = Bar(ends, rng.uniform(0.022, 0.06), post_colours)
    circle = middle + radius_m * ROUND
    return Body(middle, circle, high_m, parts=[foot, post, _Spots(corners, tuple(sign))])


class _Spots(NamedTuple):
    """Patches in the air, on a sheet that is not there: a round sign."""

    corners: Float[np.ndarray, "4 3"]
    patches: tuple[Patch, ...]

    def paint(self, canvas: Canvas, thing: int) -> None:
        """Patch after patch."""
        corners = self.corners if canvas.faces_us(self.corners) else self.corners[[1, 0, 3, 2]]
        for outline, colour in self.patches:
            a, b = outline.T
            places = corners[0] + a[:, None] * (corners[1] - corners[0]) + b[:, None] * (corners[3] - corners[0])
            canvas.area(places, colour, thing)


def _board_colour(rng: np.random.Generator) -> Colour:
    grey = np.full(3, rng.uniform(0.3, 0.8))
    return varied(rng, (YELLOW, RED, WHITE, BLUE, grey)[rng.choice(5, p=(0.24, 0.28, 0.2, 0.08, 0.2))])


def _writing(rng: np.random.Generator, board: Colour) -> tuple[Patch, ...]:
    """A ring with a bar, or lines of text, or nothing."""
    if rng.random() < _PLAIN:
        return ()
    size = np.array([rng.uniform(0.5, 0.9), rng.uniform(0.3, 0.5)])
    at = np.array([0.5 - 0.5 * size[0], rng.uniform(0.35, 0.95 - size[1])])
    red = varied(rng, RED if board[2] < 0.6 or board.min() > 0.3 or board[1] > 0.5 else WHITE)
    found = [Patch(at + size * _CIRCLE, red)]
    if rng.random() < 0.6:
        found.append(
            Patch(at + size * (0.5 + 0.72 * (_CIRCLE - 0.5)), varied(rng, (WHITE, BLUE, board)[int(rng.integers(3))]))
        )
    wide = np.array([[0.15, 0.42], [0.85, 0.42], [0.85, 0.58], [0.15, 0.58]])
    wide = 0.5 + (wide - 0.5) @ np.array([[0.7, -0.7], [0.7, 0.7]]) if rng.random() < 0.5 else wide
    found.append(Patch(at + size * wide, red if len(found) > 1 else varied(rng, WHITE)))
    ink = varied(rng, BLACK if board.mean() > 0.4 else WHITE)
    for row in range(int(rng.integers(0, 4))):
        left, low = rng.uniform(0.08, 0.3), 0.05 + 0.1 * row
        found.append(Patch(np.array([left, low]) + UNIT * [1.0 - 2.0 * left, 0.05], ink))
    return tuple(found)


_MAKES: dict[str, Callable[[np.random.Generator, np.ndarray], Body]] = {
    "cone": cone,
    "ground_lock": _ground_lock,
    "no_parking_sign": _sign,
}
