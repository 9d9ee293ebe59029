"""The road of a random view: texture, paint, shadows, what a polished floor throws back (room: simulation; host).

In: a Canvas. Out: the same, with everything below the horizon that lies flat.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from semloc_jax.simulation.cylinder_views.bodies import Body
from semloc_jax.simulation.cylinder_views.canvas import Canvas
from semloc_jax.simulation.cylinder_views.cones_and_pillars import BLACK, WHITE, YELLOW, varied
from semloc_jax.simulation.top_views.clutter import other_paint
from semloc_jax.simulation.top_views.slot_layout import Layout

_TILE = 256
_TILE_M = (0.6, 4.0, 25.0)
"""Sides of the square after which a texture repeats: grain, patches, stains."""
_COARSE = 2
"""Textures are looked up for every so many pixels."""


def sky_and_road(rng: np.random.Generator, canvas: Canvas, is_hall: bool) -> None:
    """What is behind everything: sky or ceiling above the horizon, bare road below."""
    height, width = canvas.picture.shape[:2]
    horizon = round(np.clip(canvas.centre_px[1], 0, height))
    if is_hall:
        top, low = (np.full(3, rng.uniform(0.05, 0.7)) * rng.uniform(0.9, 1.1, 3) for _ in range(2))
    else:
        blue, pale = np.array([0.85, 0.6, 0.4]) * rng.uniform(0.4, 1.3), np.full(3, rng.uniform(0.4, 1.2))
        top, low = (blue, pale) if rng.random() < 0.6 else (pale, pale * rng.uniform(0.7, 1.0, 3))
    share = np.linspace(0.0, 1.0, max(horizon, 1), dtype=np.float32)[:, None, None]
    canvas.picture[:horizon] = ((1.0 - share) * top + share * low)[:horizon]
    colour = np.full(3, rng.uniform(0.08, 0.75)) * rng.uniform(0.88, 1.12, 3)
    if rng.random() < 0.08:
        colour = np.array([0.3, 0.45, 0.6]) * rng.uniform(0.5, 1.3)  # bricks, or a painted floor
    canvas.picture[horizon:] = colour * _texture(rng, canvas, horizon, width, height)[..., None]
    if not is_hall and rng.random() < 0.4:
        _lawn(rng, canvas, horizon)


def _lawn(rng: np.random.Generator, canvas: Canvas, horizon: int) -> None:
    """Grass, earth or bushes where the lot ends, and hills behind."""
    ends = horizon + round(canvas.focal_px * canvas.height_m / rng.uniform(7.0, 30.0))
    top = horizon - round(canvas.focal_px * rng.choice([0.0, rng.uniform(0.0, 0.15)]))
    colour = (np.array([0.2, 0.45, 0.32]) if rng.random() < 0.75 else np.array([0.3, 0.4, 0.5])) * rng.uniform(0.4, 1.6)
    level = np.linspace(rng.uniform(0.7, 1.2), rng.uniform(0.7, 1.2), max(ends - top, 1), dtype=np.float32)
    rows = canvas.picture[max(top, 0) : ends]
    rows[:] = colour * level[max(-top, 0) :, None, None][: len(rows)]


def _texture(rng: np.random.Generator, canvas: Canvas, horizon: int, width: int, height: int) -> np.ndarray:
    """Brightness of the road at each pixel below the horizon, about 1."""
    rows, columns = -(-(height - horizon) // _COARSE), -(-width // _COARSE)
    below = np.maximum((np.arange(rows) + 0.5) * _COARSE, 1.0)[:, None]
    range_m = canvas.focal_px * canvas.height_m / below
    phi = ((np.arange(columns) + 0.5) * _COARSE - canvas.centre_px[0])[None] / canvas.focal_px
    x, y = range_m * np.sin(phi), range_m * np.cos(phi)
    value = np.ones((rows, columns), np.float32)
    strength = rng.uniform(0.0, 0.2, len(_TILE_M)) * rng.random(len(_TILE_M))
    for side_m, own in zip(_TILE_M, strength, strict=True):
        noise = cv2.GaussianBlur(rng.standard_normal((_TILE, _TILE), np.float32), None, rng.uniform(0.7, 3.0))
        noise /= noise.std()
        uv = [((part + side_m * rng.random()) * (_TILE / side_m) % _TILE).astype(np.float32) for part in (x, y)]
        seen = cv2.remap(noise, *uv, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        # Far off a pixel shows so much road that the grain averages out.
        fade = np.minimum(side_m / 30.0 * below**2 / (canvas.focal_px * canvas.height_m), 1.0)
        value += np.float32(own) * seen * fade.astype(np.float32)
    large = cv2.resize(np.maximum(value, 0.2), (_COARSE * columns, _COARSE * rows), interpolation=cv2.INTER_LINEAR)
    return large[: height - horizon, :width]


def paint_on_road(rng: np.random.Generator, canvas: Canvas, layout: Layout, size_m: float, shift: np.ndarray) -> None:
    """Lines of slots, arrows, writing, striped bumps.

    Args:
        rng: colours, wear.
        canvas: to paint on.
        layout: of slots in a square of `size_m`.
        size_m: its side.
        shift: where its corner is.
    """
    colour = varied(rng, WHITE if rng.random() < 0.8 else YELLOW) * rng.uniform(0.55, 1.0)
    before = canvas.picture.copy()
    for quad in [*layout.quads, *other_paint(rng, layout, size_m)]:
        flat = np.asarray(quad) + shift
        if np.linalg.norm(flat, axis=1).min() < 14.0:
            canvas.area(np.column_stack([flat, np.zeros(len(flat))]), colour, 0, 8)
    if rng.random() < 0.35:
        _bump(rng, canvas)
    worn = rng.uniform(0.5, 1.0)
    canvas.picture[:] = worn * canvas.picture + (1.0 - worn) * before


def _bump(rng: np.random.Generator, canvas: Canvas) -> None:
    """A striped bump or hatched area, as often near as far."""
    range_m, phi, yaw = np.exp(rng.uniform(-0.3, 2.2)), rng.uniform(-1.2, 1.2), rng.uniform(-np.pi, np.pi)
    along, across = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    step, wide = rng.uniform(0.2, 0.5) * along, rng.uniform(0.2, 0.6) * across
    two, num = (varied(rng, YELLOW), varied(rng, BLACK)), int(rng.integers(4, 16))
    start = range_m * np.array([np.sin(phi), np.cos(phi)]) - rng.uniform(0.2, 0.8) * num * step
    for k in range(num):
        flat = start + np.array([k * step, (k + 1) * step, (k + 1) * step + wide, k * step + wide])
        canvas.area(np.column_stack([flat, [0.0, 0.0, 0.04, 0.04]]), two[k % 2], 0, 3)


def shadows_on_road(rng: np.random.Generator, canvas: Canvas, bodies: Sequence[Body], is_hall: bool) -> None:
    """Shadows by the light, and the dark under everything."""
    shade = replace(canvas, picture=np.zeros_like(canvas.picture))
    for body in bodies:
        outline = body.shadow(np.array([0.0, 0.0, 1.0]) if is_hall else canvas.light)
        shade.area(outline, BLACK, 1, 3)
    if rng.random() < 0.3:  # of houses, trees and the own car
        middle = rng.uniform(-6.0, 6.0, 2) + [0.0, 3.0]
        corners = middle + rng.uniform(0.5, 6.0, (1, 2)) * np.array([[-1, -1], [1, -1.2], [1.3, 1], [-0.8, 1]])
        shade.area(np.column_stack([corners, np.zeros(4)]), BLACK, 1, 8)
    soft = cv2.GaussianBlur(255 * shade.ids, None, rng.uniform(0.8, 7.0)).astype(np.float32) / 255.0
    horizon = max(round(canvas.centre_px[1]), 0)
    canvas.picture[horizon:] *= 1.0 - rng.uniform(0.25, 0.7) * soft[horizon:, :, None]


def thrown_back(rng: np.random.Generator, canvas: Canvas, bodies: Sequence[Body]) -> None:
    """What a wet or polished floor mirrors."""
    horizon, share = max(round(canvas.centre_px[1]), 0), rng.uniform(0.08, 0.45)
    below = canvas.picture.copy()
    mirror = replace(canvas, picture=below, is_mirrored=True)
    for body in bodies:
        body.paint(mirror)
    for _ in range(int(rng.integers(0, 5))):  # lamps
        u, v = rng.random(2) * [below.shape[1], below.shape[0]]
        half = rng.uniform(4.0, 40.0, 2)
        outline = np.array([u, max(v, horizon)]) + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        mirror.fill(outline, np.full(3, rng.uniform(0.8, 2.5)))
    size = rng.uniform(1.0, 9.0)
    soft = cv2.GaussianBlur(below, None, sigmaX=size, sigmaY=size * rng.uniform(1.0, 3.0))
    canvas.picture[horizon:] += np.float32(share) * (soft - canvas.picture)[horizon:]


def lamps(rng: np.random.Generator, canvas: Canvas) -> None:
    """Bright lamps under a ceiling, with their glare."""
    glow = np.zeros_like(canvas.picture)
    horizon = max(round(canvas.centre_px[1]), 1)
    for _ in range(int(rng.integers(1, 7))):
        at = rng.random(2) * [glow.shape[1], horizon]
        half = rng.uniform(3.0, 26.0, 2)
        outline = np.round(at + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])).astype(np.int32)
        cv2.fillPoly(glow, [outline], (rng.uniform(0.5, 2.0),) * 3)
    canvas.picture += cv2.GaussianBlur(glow, None, rng.uniform(2.0, 14.0))
