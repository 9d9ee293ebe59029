"""A random view on an upright cylinder with the obstacles in it (room: simulation; host).

In: a random generator, sizes. Out: CylinderSample: picture, boxes, feet, classes, where nothing may be asked.
Cars, people and posts hide and confuse; light, road, colours, shadows, mirrors, lenses and noise are drawn anew for
every picture.
"""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from semloc_jax.perception.cylinder_view import resized
from semloc_jax.simulation.cylinder_views.bodies import Body
from semloc_jax.simulation.cylinder_views.bystanders import background
from semloc_jax.simulation.cylinder_views.canvas import Canvas
from semloc_jax.simulation.cylinder_views.ground import (
    lamps,
    paint_on_road,
    shadows_on_road,
    sky_and_road,
    thrown_back,
)
from semloc_jax.simulation.cylinder_views.placing import RANGE_M, SIZE_M, placed

_FINER = 2
"""Pictures are painted so many times finer and averaged."""
_BLURRED, _ALIASED = 0.7, 0.25
"""Shares of the pictures."""
_BLUR_PX = (0.25, 1.0)
"""Standard deviations of the lens [px of the camera]."""
_SLOPE_RAD = 0.01
"""Standard deviation of the road against the level, and of the mount against what is known of it."""


class Geometry(NamedTuple):
    """A window of a cylinder.

    Args:
        focal_px: pixels a radian.
        width, height: of the window [px].
        centre_v: row of the horizon.
        enlarged: so many times as large as the camera took it.
        low_m: range of what is low; pillars stand at any.
    """

    focal_px: float
    width: int
    height: int
    centre_v: float
    enlarged: float = 1.0
    low_m: tuple[float, float] = RANGE_M


class SeenThing(NamedTuple):
    """One obstacle of a picture.

    Args:
        kind: class of OBSTACLES.
        box: left, top, right, lower border of what is seen of it [px].
        foot_uv: pixel of the middle of its footprint on the road, seen or not.
        range_m: of that from the camera.
        shown: share of it that nothing hides.
        has_foot: whether its lower end is seen.
    """

    kind: str
    box: Float[np.ndarray, " 4"]
    foot_uv: Float[np.ndarray, " 2"]
    range_m: float
    shown: float
    has_foot: bool


class CylinderSample(NamedTuple):
    """One picture to learn from: uint8[h w 3] blue green red, and what is in it."""

    picture: UInt8[np.ndarray, "h w 3"]
    things: list[SeenThing]
    centre_v: float
    enlarged: float


def cylinder_sample(rng: np.random.Generator, geometry: Geometry) -> CylinderSample:
    """A picture with its obstacles.

    Args:
        rng: all that is random.
        geometry: of the window.
    """
    is_hall = bool(rng.random() < 0.45)
    ceiling_m = float(rng.uniform(2.1, 3.8)) if is_hall else None
    canvas = _canvas(rng, geometry)
    half_rad, size_m = 0.5 * canvas.picture.shape[1] / canvas.focal_px, max(SIZE_M, 2.0 * geometry.low_m[1])
    bodies, slots = placed(rng, half_rad, ceiling_m, geometry.low_m, size_m)
    sky_and_road(rng, canvas, is_hall)
    if is_hall and rng.random() < 0.7:
        lamps(rng, canvas)
    paint_on_road(rng, canvas, slots, size_m, np.full(2, -0.5 * size_m))
    shadows_on_road(rng, canvas, bodies, is_hall)
    far_first = sorted(bodies, key=lambda body: -float(np.linalg.norm(body.middle)))
    if rng.random() < (0.6 if is_hall else 0.12):
        thrown_back(rng, canvas, [*background(rng, ceiling_m), *far_first])
    walls = sorted(background(rng, ceiling_m), key=lambda body: -float(np.linalg.norm(body.middle)))
    for body in walls:
        body.paint(canvas)
    canvas.ids[:] = 0
    for number, body in enumerate(far_first, 1):
        body.paint(canvas, number)
    _own_car(rng, canvas)
    alone = replace(canvas, picture=np.zeros_like(canvas.picture))
    things = [_seen(canvas, alone, body, k) for k, body in enumerate(far_first, 1) if body.kind]
    seen = [t for t in things if t is not None]
    return CylinderSample(_finished(rng, canvas, geometry), seen, geometry.centre_v, geometry.enlarged)


def _canvas(rng: np.random.Generator, geometry: Geometry) -> Canvas:
    sun, low = rng.uniform(-np.pi, np.pi), rng.uniform(0.15, 1.5)
    light = np.array([np.cos(sun) * np.cos(low), np.sin(sun) * np.cos(low), np.sin(low)])
    picture = np.zeros((_FINER * geometry.height, _FINER * geometry.width, 3), np.float32)
    # Pixel centres are at whole numbers: those of the finer picture lie half a step off.
    centre_v = geometry.centre_v + geometry.focal_px * _SLOPE_RAD * rng.standard_normal()
    centre = (_FINER * 0.5 * geometry.width - 0.5, _FINER * (centre_v + 0.5) - 0.5)
    ambient = rng.uniform(0.35, 0.9)
    return Canvas(_FINER * geometry.focal_px, centre, rng.uniform(0.5, 1.5), light, ambient, picture)


def _own_car(rng: np.random.Generator, canvas: Canvas) -> None:
    """Doors and bumpers of the own car, and where the lens shows nothing."""
    height, width = canvas.ids.shape
    for side in (0, 1):
        if rng.random() < 0.2:
            at, lean = rng.uniform(0.0, 0.35) * width, rng.uniform(-0.3, 0.3) * width
            edge = np.array([[-1.0, -1.0], [at, -1.0], [at + lean, height], [-1.0, height]])
            edge[:, 0] = edge[:, 0] if side == 0 else width - 1 - edge[:, 0]
            colour = np.zeros(3) if rng.random() < 0.5 else np.full(3, rng.uniform(0.02, 0.8))
            canvas.fill(edge, colour, 0)
    if rng.random() < 0.2:
        low = height * rng.uniform(0.7, 1.0)
        canvas.fill(
            np.array([[-1.0, low], [width, low + 20.0], [width, height], [-1.0, height]]),
            np.full(3, rng.uniform(0.0, 0.7)),
            0,
        )


def _seen(canvas: Canvas, alone: Canvas, body: Body, number: int) -> SeenThing | None:
    """What is seen of a thing; None where it is nothing. It is painted once more, where nothing hides it."""
    own = canvas.ids == number
    rows = np.flatnonzero(own.any(axis=1))
    if not len(rows):
        return None
    columns = np.flatnonzero(own.any(axis=0))
    alone.ids[:] = 0
    body.paint(alone, 1)
    whole = alone.ids > 0
    low = np.flatnonzero(whole.any(axis=1))
    last = whole.copy()
    last[: round(low[-1] - 0.12 * (low[-1] - low[0]))] = False
    inside = low[-1] < canvas.ids.shape[0] - 1
    box = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1]) / _FINER - 0.5
    foot = canvas.pixels(np.append(body.middle, 0.0)[None])[0]
    return SeenThing(
        body.kind,
        box,
        (foot + 0.5) / _FINER - 0.5,
        float(np.linalg.norm(body.middle)),
        float(own.sum() / max(whole.sum(), 1)),
        bool(inside and (own & last).sum() > 0.5 * last.sum()),
    )


def _finished(rng: np.random.Generator, canvas: Canvas, geometry: Geometry) -> UInt8[np.ndarray, "h w 3"]:
    """Lens, exposure, tint, haze, noise, compression."""
    picture = canvas.picture
    if rng.random() < 0.25:  # light falls off
        row = np.linspace(rng.uniform(0.4, 1.0), rng.uniform(0.6, 1.2), len(picture), dtype=np.float32)
        picture = picture * row[:, None, None]
    if rng.random() < 0.5:  # glare of lamps and of what the sun shines on
        glare = cv2.GaussianBlur(np.maximum(picture - 1.0, 0.0), None, rng.uniform(2.0, 10.0))
        picture = picture + np.float32(rng.uniform(0.3, 1.5)) * glare
    if rng.random() < _BLURRED:
        picture = cv2.GaussianBlur(picture, None, _FINER * geometry.enlarged * rng.uniform(*_BLUR_PX))
    size = (geometry.width, geometry.height)
    # Lens, noise and compression are of the pixels that the camera took.
    taken = (round(size[0] / geometry.enlarged), round(size[1] / geometry.enlarged))
    # Cameras without an optical low pass alias: far lines become dots.
    is_sampled = rng.random() < _ALIASED
    small = cv2.resize(picture, taken, interpolation=cv2.INTER_NEAREST if is_sampled else cv2.INTER_AREA)
    gamma, gain = rng.uniform(0.7, 1.3), rng.uniform(0.65, 1.4)
    small = np.maximum(small, np.float32(1e-3)) ** np.float32(gamma) * np.float32(gain)
    small = small * (1.0 + 0.05 * rng.standard_normal(3)).astype(np.float32)
    if rng.random() < 0.3:
        small = small + np.float32(rng.uniform(0.0, 0.14))
    grain = np.float32(rng.uniform(0.0, 0.06)) * np.float32(rng.random())
    noise = rng.standard_normal(small.shape, np.float32)
    small = small + grain * (noise if rng.random() < 0.5 else cv2.GaussianBlur(noise, None, 0.8) * 2.0)
    shown = np.clip(255.0 * small, 0.0, 255.0).astype(np.uint8)
    if rng.random() < 0.5:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(45, 95))]
        shown = cv2.imdecode(cv2.imencode(".jpg", shown, quality)[1], cv2.IMREAD_COLOR)
    return resized(shown, size)
