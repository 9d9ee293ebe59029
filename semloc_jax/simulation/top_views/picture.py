"""A random top view of parking slots as a surround view would show it (room: simulation; host).

In: a random generator, a size. Out: TopViewSample: picture, marking points, where nothing may be asked.
Light, asphalt, wear, shadows, colour cast, seams with steps of brightness, mounts that are off, blur, noise: each is
drawn anew for every picture.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.simulation.top_views.clutter import filled, other_paint, shadows, things
from semloc_jax.simulation.top_views.drawn_out import OwnCar, drawn_out, own_car, wedge
from semloc_jax.simulation.top_views.slot_layout import DividerBack, Layout, MarkingPoint, random_layout

_FINER = 2
"""Pictures are drawn so many times finer and averaged."""
_HIDDEN_M = 0.12
"""A point with something so near is not asked for."""
_RIM_M = 0.15
"""Nor one so near to the border of the picture or of what is shown."""
_WORN_OUT = 0.25
"""Nor one of whose paint less is left."""
_SAME_M = 0.3
"""Mounts that are off move a point from where it was painted by no more."""
_OPEN_PX = 6
"""So far around such a point nothing is asked."""


class TopViewSample(NamedTuple):
    """One picture to learn from.

    Attributes:
        picture: uint8[n n 3], blue green red.
        points: what it shows, in metres from its upper left corner.
        unasked: bool[n n], where a point is hidden or worn off: neither there nor not there.
    """

    picture: UInt8[np.ndarray, "n n 3"]
    points: list[MarkingPoint]
    unasked: Bool[np.ndarray, "n n"]


def top_view_sample(rng: np.random.Generator, size_px: int, metres_per_px: float) -> TopViewSample:
    """A picture of the size with its points.

    Args:
        rng: all that is random.
        size_px: its side.
        metres_per_px: of its pixels.
    """
    size_m, fine = size_px * metres_per_px, _FINER / metres_per_px
    n = size_px * _FINER
    layout = random_layout(rng, size_m) if rng.random() < 0.92 else Layout()
    ground = _ground(rng, n)
    alpha = _paint(rng, layout, size_m, n, fine)
    colour = _paint_colour(rng, ground)
    picture = ground + alpha[..., None] * (colour - ground)
    car = own_car(rng, size_m)
    picture *= _light(rng, size_m, n, fine)[..., None] * _reflections(rng, car, size_m, n, fine)[..., None]
    covered = np.zeros((n, n), np.uint8)
    for area in [*things(rng, layout, size_m), *drawn_out(rng, car, size_m)]:
        filled(picture, area.outline_m, fine, tuple(float(value) for value in area.colour))
        if area.is_high:
            filled(covered, area.outline_m, fine, 255)
    points, picture, covered = _seen_by_cameras(rng, car, layout.points, picture, covered, fine)
    picture = _finished(rng, picture, size_px)
    return _asked(picture, points, layout.backs, covered, alpha, size_m, fine)


def _ground(rng: np.random.Generator, n: int) -> Float[np.ndarray, "n n 3"]:
    """Asphalt, concrete, coloured floor or bricks."""
    grey = np.full((n, n), rng.uniform(0.12, 0.6), np.float32)
    for cells, depth in ((4, 0.1), (16, 0.06), (64, 0.05), (n, 0.07)):
        noise = rng.standard_normal((min(cells, n), min(cells, n)), np.float32)
        grey *= 1.0 + rng.uniform(0.0, depth) * cv2.resize(noise, (n, n), interpolation=cv2.INTER_LINEAR)
    if rng.random() < 0.12:
        _bricks(rng, grey)
    for _ in range(int(rng.integers(0, 3))):  # cracks and seams of tar
        a = n * rng.random(2)
        places = np.cumsum(np.vstack([a, rng.normal(0.0, 0.06 * n, (8, 2))]), axis=0)
        cv2.polylines(grey, [places.astype(np.int32)], False, float(grey.mean() * rng.uniform(0.4, 0.8)), 1)
    tint = 1.0 + rng.normal(0.0, 0.03, 3) if rng.random() < 0.9 else rng.uniform(0.6, 1.3, 3)
    return np.clip(grey[..., None] * tint.astype(np.float32), 0.02, 1.0)


def _bricks(rng: np.random.Generator, grey: np.ndarray) -> None:
    n = len(grey)
    step, dark = int(rng.integers(8, 24)), float(rng.uniform(0.6, 0.9))
    grey[::step] *= dark
    for row in range(0, n, step):
        grey[row : row + step, (row // step % 2) * step // 2 :: step] *= dark


def _paint(rng: np.random.Generator, layout: Layout, size_m: float, n: int, fine: float) -> np.ndarray:
    """How much paint each pixel has, 0 ... 1: lines, worn in patches and grains."""
    alpha = np.zeros((n, n), np.uint8)
    for outline in [*layout.quads, *other_paint(rng, layout, size_m)]:
        filled(alpha, outline, fine, 255)
    worn = np.zeros((n, n), np.float32)
    for cells, depth in ((6, 1.0), (40, 0.8), (n // 2, 0.6)):
        noise = rng.standard_normal((cells, cells), np.float32)
        worn += depth * cv2.resize(noise, (n, n), interpolation=cv2.INTER_LINEAR)
    limit = rng.uniform(0.3, 4.0)
    left = 1.0 / (1.0 + np.exp(4.0 * (worn - limit)))
    return alpha.astype(np.float32) / 255.0 * left * rng.uniform(0.55, 1.0)


def _paint_colour(rng: np.random.Generator, ground: np.ndarray) -> Float[np.ndarray, " 3"]:
    """White or yellow, seldom blue or red, brighter than the ground by little or much."""
    colours = np.array([[1.0, 1.0, 1.0], [0.25, 0.8, 0.95], [0.9, 0.5, 0.2], [0.25, 0.25, 0.85]])
    chosen = colours[rng.choice(4, p=(0.74, 0.18, 0.04, 0.04))]
    level = float(ground.mean())
    return (chosen * rng.uniform(min(level + 0.12, 0.9), 1.0)).astype(np.float32)


def _light(rng: np.random.Generator, size_m: float, n: int, fine: float) -> Float[np.ndarray, "n n"]:
    """Shadows with soft edges, and a slope of brightness."""
    light = np.ones((n, n), np.float32)
    for outline in shadows(rng, size_m):
        part = np.zeros((n, n), np.float32)
        filled(part, outline, fine, 1.0)
        light *= 1.0 - rng.uniform(0.3, 0.7) * cv2.GaussianBlur(part, None, rng.uniform(0.7, 6.0))
    if rng.random() < 0.25:  # lamps that a wet or polished floor throws back
        for _ in range(int(rng.integers(1, 4))):
            part = np.zeros((n, n), np.float32)
            place, size = size_m * rng.random(2), rng.uniform(0.1, 1.5, 2)
            filled(part, place + 0.5 * size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), fine, 1.0)
            light += rng.uniform(0.3, 2.0) * cv2.GaussianBlur(part, None, rng.uniform(3.0, 12.0))
    ramp = np.linspace(-0.5, 0.5, n, dtype=np.float32)
    return light * (1.0 + rng.uniform(-0.4, 0.4) * ramp[None]) * (1.0 + rng.uniform(-0.4, 0.4) * ramp[:, None])


def _reflections(rng: np.random.Generator, car: OwnCar, size_m: float, n: int, fine: float) -> Float[np.ndarray, "n n"]:
    """Lamps and bright walls that a wet or polished floor throws back: they run along the lines of sight."""
    light = np.ones((n, n), np.float32)
    if rng.random() < 0.75:
        return light
    for _ in range(int(rng.integers(4, 24))):
        part = np.zeros((n, n), np.float32)
        filled(part, wedge(rng, car, size_m, rng.uniform(0.03, 0.2), rng.uniform(0.3, 4.0)), fine, 1.0)
        light += rng.uniform(0.2, 1.2) * cv2.GaussianBlur(part, None, rng.uniform(1.0, 6.0))
    return light


def _seen_by_cameras(
    rng: np.random.Generator,
    car: OwnCar,
    points: list[MarkingPoint],
    picture: np.ndarray,
    covered: np.ndarray,
    fine: float,
) -> tuple[list[MarkingPoint], np.ndarray, np.ndarray]:
    """Four cameras around a car, each with a mount, a gain and a tint a little off; the car itself is black."""
    n, middle = len(picture), car.middle_m
    sector = _sectors(n, middle, car.heading_rad, fine)
    gains = (1.0 + abs(rng.normal(0.0, 0.08)) * rng.standard_normal((4, 3))).astype(np.float32)
    seen, hidden, moved = picture, covered, list(points)
    if rng.random() < 0.5:
        moved, seen, hidden = _mounts_off(rng, points, picture, covered, sector, middle, fine)
    seen = seen * gains[sector]
    if rng.random() < 0.6:
        corners = middle + 0.5 * car.size_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        filled(seen, corners, fine, (float(rng.choice([0.0, 0.0, 0.3])),) * 3)
        filled(hidden, corners, fine, 255)
    return moved, seen, hidden


def _mounts_off(
    rng: np.random.Generator,
    points: list[MarkingPoint],
    picture: np.ndarray,
    covered: np.ndarray,
    sector: np.ndarray,
    middle: np.ndarray,
    fine: float,
) -> tuple[list[MarkingPoint], np.ndarray, np.ndarray]:
    """The parts of the cameras, each moved and turned a little, and the points in them."""
    n, seen, hidden, moved = len(picture), picture.copy(), covered.copy(), list(points)
    off_m, off_rad = abs(rng.normal(0.0, 0.04)), abs(rng.normal(0.0, np.deg2rad(0.6)))
    for k in np.unique(sector).tolist():
        turn, step = off_rad * rng.standard_normal(), off_m * rng.standard_normal(2)
        A = _turn_about(middle, turn, step)
        px = A.copy()
        px[:, 2] = fine * A[:, 2] + 0.5 * (A[:, :2].sum(axis=1) - 1.0)
        part, shade = (
            cv2.warpAffine(image, px, (n, n), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for image in (picture, covered)
        )
        own = sector == k
        seen[own], hidden[own] = part[own], shade[own]
        for j, point in enumerate(points):
            place = A[:, :2] @ point.uv_m + A[:, 2]
            v, u = np.clip((place[::-1] * fine).astype(int), 0, n - 1)
            if sector[v, u] == k:
                moved[j] = point._replace(uv_m=place, yaw_rad=point.yaw_rad + turn)
    return moved, seen, hidden


def _sectors(n: int, middle: np.ndarray, heading: float, fine: float) -> np.ndarray:
    """Which camera shows each pixel: seams run from the corners of the car outward."""
    place = (np.arange(n, dtype=np.float32) + 0.5) / np.float32(fine)
    u, v = place[None] - np.float32(middle[0]), place[:, None] - np.float32(middle[1])
    x, y = (u, v) if heading == 0.0 else (v, u)
    lies_ahead = np.abs(y) - np.float32(2.2) > np.abs(x) - np.float32(0.9)
    return np.where(lies_ahead, (y > 0).astype(np.uint8), (x > 0).astype(np.uint8) + np.uint8(2))


def _turn_about(middle: np.ndarray, turn: float, step: np.ndarray) -> Float[np.ndarray, "2 3"]:
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s], [s, c]])
    return np.column_stack([R, middle - R @ middle + step])


def _finished(rng: np.random.Generator, picture: np.ndarray, size_px: int) -> UInt8[np.ndarray, "n n 3"]:
    """Blur, exposure, tint, noise, compression."""
    if rng.random() < 0.6:
        picture = cv2.GaussianBlur(picture, None, rng.uniform(0.4, 2.6))
    small = cv2.resize(picture, (size_px, size_px), interpolation=cv2.INTER_AREA)
    small = np.maximum(small, np.float32(1e-3)) ** np.float32(rng.uniform(0.7, 1.4)) * np.float32(rng.uniform(0.6, 1.5))
    tint, grain = (1.0 + 0.06 * rng.standard_normal(3, np.float32)), np.float32(rng.uniform(0.0, 0.03))
    small = small * tint + grain * rng.standard_normal(small.shape, np.float32)
    if rng.random() < 0.4:
        small = small + rng.uniform(0.0, 0.15)  # haze of a dirty lens
    shown = np.clip(255.0 * small, 0.0, 255.0).astype(np.uint8)
    if rng.random() < 0.5:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(40, 95))]
        shown = cv2.imdecode(cv2.imencode(".jpg", shown, quality)[1], cv2.IMREAD_COLOR)
    return shown


def _asked(
    picture: np.ndarray,
    points: list[MarkingPoint],
    backs: list[DividerBack],
    covered: np.ndarray,
    alpha: np.ndarray,
    size_m: float,
    fine: float,
) -> TopViewSample:
    """The points that the picture shows; what it hides, and backs of slots that it does not tell, are left open."""
    n, size_px = len(alpha), len(picture)
    near = round(_HIDDEN_M * fine)
    hidden = cv2.dilate(covered, np.ones((2 * near + 1, 2 * near + 1), np.uint8)) > 64
    kept, unasked = [], np.zeros((size_px, size_px), bool)
    for point in points:
        u, v = np.clip((point.uv_m * fine).astype(int), 0, n - 1)
        inside = ((point.uv_m > _RIM_M) & (point.uv_m < size_m - _RIM_M)).all()
        around = alpha[max(v - near, 0) : v + near + 1, max(u - near, 0) : u + near + 1]
        if inside and not hidden[v, u] and around.max() > _WORN_OUT:
            kept.append(point)
        else:
            _leave_open(unasked, point.uv_m * fine / _FINER)
    told = np.array([point.uv_m for point in kept]).reshape(-1, 2)
    for back in backs:
        if back.mouth_m is None or not (np.linalg.norm(told - back.mouth_m, axis=1) < _SAME_M).any():
            _leave_open(unasked, back.uv_m * fine / _FINER)
    return TopViewSample(picture, kept, unasked)


def _leave_open(unasked: np.ndarray, place_px: np.ndarray) -> None:
    low, high = (np.clip(np.round(place_px).astype(int) + by, 0, len(unasked)) for by in (-_OPEN_PX, _OPEN_PX + 1))
    unasked[low[1] : high[1], low[0] : high[0]] = True
