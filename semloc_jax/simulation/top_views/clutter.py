"""What else a top view shows: other paint, cars, shadows, kerbs, drains (room: simulation; host).

In: a random generator, a Layout. Out: more areas of paint; areas with colours. None of them has a marking point.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.simulation.top_views.slot_layout import Layout


class ColouredArea(NamedTuple):
    """Something that hides the road.

    Args:
        outline_m: `float64[k 2]`.
        colour: blue, green, red in 0 ... 1.
        is_high: whether it hides paint for good; what lies flat on it is still beside it.
    """

    outline_m: Float[np.ndarray, "k 2"]
    colour: Float[np.ndarray, " 3"]
    is_high: bool = True


def other_paint(rng: np.random.Generator, layout: Layout, size_m: float) -> list[Float[np.ndarray, "k 2"]]:
    """Arrows, crosswalks, hatched areas, lane lines and strokes of writing."""
    found: list[np.ndarray] = []
    if rng.random() < 0.3:
        found += _arrow(rng, layout, size_m)
    if rng.random() < 0.15:
        found += _stripes(rng, size_m, rng.uniform(0.35, 0.6), rng.uniform(2.0, 4.0), int(rng.integers(3, 8)))
    if rng.random() < 0.1:
        found += _stripes(rng, size_m, rng.uniform(0.1, 0.2), rng.uniform(0.8, 2.0), int(rng.integers(4, 12)))
    if rng.random() < 0.25:
        found += _lane_line(rng, size_m)
    if rng.random() < 0.25:
        found += _writing(rng, layout, size_m)
    return found


def things(rng: np.random.Generator, layout: Layout, size_m: float) -> list[ColouredArea]:
    """Parked cars in some slots, a passing one, pillars, kerbs, grass and lids."""
    found: list[ColouredArea] = []
    full = rng.choice([0.0, 0.25, 0.6])
    for slot in layout.slots:
        if rng.random() < full:
            found += _parked(rng, slot)
    if rng.random() < 0.1:
        found += _car(rng, size_m * rng.random(2), rng.uniform(-np.pi, np.pi))
    if rng.random() < 0.2:
        middle, grey = size_m * rng.random(2), rng.uniform(0.3, 0.9)
        found.append(
            ColouredArea(_rectangle(middle, rng.uniform(0.3, 1.0, 2), rng.uniform(-np.pi, np.pi)), np.full(3, grey))
        )
    if rng.random() < 0.15:
        found += _edge(rng, layout, size_m)
    if rng.random() < 0.3:
        angle = np.linspace(0.0, 2.0 * np.pi, 24)
        circle = size_m * rng.random(2) + rng.uniform(0.2, 0.4) * np.column_stack([np.cos(angle), np.sin(angle)])
        found.insert(0, ColouredArea(circle, np.full(3, rng.uniform(0.1, 0.6)), False))
    return found


def shadows(rng: np.random.Generator, size_m: float) -> list[Float[np.ndarray, "k 2"]]:
    """Straight-edged shadows of houses and cars."""
    if rng.random() < 0.55:
        return []
    return [
        _rectangle(size_m * rng.uniform(-0.2, 1.2, 2), rng.uniform(1.0, 6.0, 2), rng.uniform(-np.pi, np.pi))
        for _ in range(int(rng.integers(1, 4)))
    ]


def _rectangle(middle: np.ndarray, size_m: np.ndarray, yaw: float) -> Float[np.ndarray, "4 2"]:
    corners = 0.5 * size_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return middle + _turned(corners, yaw)


def _turned(places: np.ndarray, yaw: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return places @ np.array([[c, s], [-s, c]])


def _arrow(rng: np.random.Generator, layout: Layout, size_m: float) -> list[np.ndarray]:
    """A shaft and a head along the aisle."""
    long_m, head_m, wide_m = rng.uniform(1.2, 3.5), rng.uniform(0.5, 1.0), rng.uniform(0.12, 0.3)
    shaft = np.array([[0, -wide_m], [long_m, -wide_m], [long_m, wide_m], [0, wide_m]]) * [1.0, 0.5]
    head = np.array([[long_m, -0.5 * head_m], [long_m + head_m, 0.0], [long_m, 0.5 * head_m]])
    yaw = float(np.arctan2(layout.along[1], layout.along[0])) + rng.choice([0.0, np.pi])
    middle = size_m * rng.random(2)
    return [middle + _turned(part, yaw) for part in (shaft, head)]


def _stripes(rng: np.random.Generator, size_m: float, wide_m: float, long_m: float, num: int) -> list[np.ndarray]:
    """Parallel bars: a crosswalk or a hatched area."""
    yaw, middle = rng.uniform(-np.pi, np.pi), size_m * rng.random(2)
    step = wide_m * rng.uniform(1.6, 2.5)
    return [
        middle + _turned(_rectangle(np.array([k * step, 0.0]), np.array([wide_m, long_m]), 0.0), yaw)
        for k in range(num)
    ]


def _lane_line(rng: np.random.Generator, size_m: float) -> list[np.ndarray]:
    yaw, middle, wide_m = rng.uniform(-np.pi, np.pi), size_m * rng.random(2), rng.uniform(0.08, 0.2)
    if rng.random() < 0.5:
        return [middle + _turned(_rectangle(np.zeros(2), np.array([3.0 * size_m, wide_m]), 0.0), yaw)]
    dash_m = rng.uniform(0.8, 3.0)
    places = np.arange(-size_m, size_m, 2.0 * dash_m)
    return [middle + _turned(_rectangle(np.array([s, 0.0]), np.array([dash_m, wide_m]), 0.0), yaw) for s in places]


def _writing(rng: np.random.Generator, layout: Layout, size_m: float) -> list[np.ndarray]:
    """Strokes of numbers and letters, mostly inside of slots."""
    middle = size_m * rng.random(2)
    if layout.slots and rng.random() < 0.7:
        slot = layout.slots[int(rng.integers(len(layout.slots)))]
        middle = slot.mean(axis=0) + rng.normal(0.0, 0.3, 2)
    yaw = float(np.arctan2(layout.along[1], layout.along[0])) + rng.choice([0.0, np.pi])
    high_m, wide_m = rng.uniform(0.3, 1.0), rng.uniform(0.05, 0.12)
    found = []
    for glyph in range(int(rng.integers(1, 4))):
        for _ in range(int(rng.integers(2, 5))):
            at = np.array([0.7 * glyph * high_m, 0.0]) + high_m * rng.uniform(-0.3, 0.3, 2)
            size = high_m * rng.uniform(0.3, 1.0)
            part = _rectangle(at, np.array([size, wide_m]), float(rng.choice([0.0, 0.5 * np.pi, 0.8])))
            found.append(middle + _turned(part, yaw))
    return found


def _parked(rng: np.random.Generator, slot: Float[np.ndarray, "4 2"]) -> list[ColouredArea]:
    """A car in a slot, seen from above with its sides drawn out."""
    middle = slot.mean(axis=0) + rng.normal(0.0, 0.15, 2)
    long_side = slot[3] - slot[0] if np.linalg.norm(slot[3] - slot[0]) > np.linalg.norm(slot[1] - slot[0]) else None
    step = slot[1] - slot[0] if long_side is None else long_side
    return _car(rng, middle, float(np.arctan2(step[1], step[0])) + rng.normal(0.0, 0.03))


def _car(rng: np.random.Generator, middle: np.ndarray, yaw: float) -> list[ColouredArea]:
    size = np.array([rng.uniform(3.6, 4.9), rng.uniform(1.6, 1.95)]) * rng.uniform(1.0, 1.25, 2)
    colour = np.clip(rng.uniform(0.05, 0.95) + rng.normal(0.0, 0.15, 3), 0.02, 1.0)
    body = _rounded(_rectangle(middle, size, yaw))
    found = [ColouredArea(middle + 1.06 * (body - middle), np.full(3, 0.05), False), ColouredArea(body, colour)]
    for share, at in ((0.14, 0.15), (0.1, -0.32)):
        glass = _rectangle(np.array([at * size[0], 0.0]), np.array([share * size[0], 0.8 * size[1]]), 0.0)
        found.append(ColouredArea(middle + _turned(glass, yaw), np.full(3, rng.uniform(0.05, 0.3))))
    return found


def _rounded(corners: Float[np.ndarray, "4 2"]) -> Float[np.ndarray, "8 2"]:
    after, before = np.roll(corners, -1, axis=0), np.roll(corners, 1, axis=0)
    return np.stack([corners + 0.12 * (before - corners), corners + 0.12 * (after - corners)], axis=1).reshape(-1, 2)


def _edge(rng: np.random.Generator, layout: Layout, size_m: float) -> list[ColouredArea]:
    """A kerb with grass or a pavement behind it, along the aisle or across."""
    side = layout.along if rng.random() < 0.6 else np.array([-layout.along[1], layout.along[0]])
    yaw, normal = float(np.arctan2(side[1], side[0])), np.array([-side[1], side[0]]) * rng.choice([-1.0, 1.0])
    middle = 0.5 * size_m + normal * size_m * rng.uniform(0.3, 0.6)
    green = np.array([0.15, 0.4, 0.25]) * rng.uniform(0.5, 1.6)
    colour = green if rng.random() < 0.5 else np.full(3, rng.uniform(0.3, 0.75))
    kerb = ColouredArea(_rectangle(middle, np.array([3.0 * size_m, 0.25]), yaw), np.full(3, rng.uniform(0.3, 0.9)))
    return [ColouredArea(_rectangle(middle + 2.1 * normal, np.array([3.0 * size_m, 4.2]), yaw), colour), kerb]


def filled(canvas: np.ndarray, outline_m: np.ndarray, px_per_m: float, value: float | int | tuple[float, ...]) -> None:
    """Fill an area of a picture; edges are between pixels."""
    fixed = np.round((outline_m * px_per_m - 0.5) * 16.0).astype(np.int32)
    cv2.fillPoly(canvas, [fixed], value, cv2.LINE_AA, 4)
