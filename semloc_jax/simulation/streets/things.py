"""What stands beside and on a random street: posts, signs, lights, lamps, gantries, trees, fronts, rails, vehicles
(room: simulation; host).

In: a random generator, places. Out: solids with the ids of their classes.
"""

from itertools import pairwise

import numpy as np

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.simulation.looks.materials import BANDED, GLOWING, STRIPED, variant_id
from semloc_jax.simulation.solids import Ball, Box, Frustum, Plate, Solid, rotation_about_z

_FACES = (
    (0.92, 0.92, 0.92),
    (0.15, 0.12, 0.75),
    (0.65, 0.25, 0.08),
    (0.3, 0.45, 0.08),
    (0.1, 0.75, 0.9),
    (0.2, 0.2, 0.2),
)
"""Colours of signs, blue green red."""
_GREY_BACK = (0.45, 0.45, 0.45)
_CORNERS = {"circle": 20, "triangle": 3, "rectangle": 4, "octagon": 8, "diamond": 4}
_VEHICLE, _POLE, _SIGN = CLASS_IDS["vehicle"], CLASS_IDS["pole"], CLASS_IDS["sign"]


def grey(rng: np.random.Generator, low: float = 0.1, high: float = 0.85) -> tuple[float, float, float]:
    """A colour near grey, as bright as may be between two shares of white."""
    tone = rng.uniform(low, high) * (1.0 + rng.normal(0.0, 0.06, 3))
    return tuple(np.clip(tone, 0.02, 0.95).tolist())


def _tilted(direction: np.ndarray) -> np.ndarray:
    """R [3 3] whose first axis runs along a direction."""
    x = direction / np.linalg.norm(direction)
    y = np.cross([0.0, 0.0, 1.0], x)
    y = y / np.linalg.norm(y) if np.linalg.norm(y) > 1e-6 else np.array([0.0, 1.0, 0.0])
    return np.column_stack([x, y, np.cross(x, y)])


def bar(class_id: int, color: tuple, start: np.ndarray, end: np.ndarray, thick_m: float) -> Box:
    """A beam between two places."""
    way = end - start
    return Box(class_id, color, 0.5 * (start + end), (float(np.linalg.norm(way)), thick_m, thick_m), _tilted(way))


def delineator(base: np.ndarray, rng: np.random.Generator) -> list[Solid]:
    """A post beside the road: white with a band, plain, or a striped bollard."""
    kind = int(rng.choice(3, p=(0.7, 0.2, 0.1)))
    variant, color = (BANDED, 0, STRIPED)[kind], ((0.9, 0.9, 0.9), grey(rng), (0.15, 0.5, 0.9))[kind]
    radius = rng.uniform(0.04, 0.08)
    return [
        Frustum(
            variant_id("pole", variant), color, base, rng.uniform(0.85, 1.15), radius, radius * rng.uniform(0.8, 1.0)
        )
    ]


def lamp(base: np.ndarray, towards: np.ndarray, rng: np.random.Generator) -> list[Solid]:
    """A lamp post with an arm over the street, or one without."""
    height, radius, color = rng.uniform(4.0, 11.0), rng.uniform(0.05, 0.15), grey(rng)
    solids: list[Solid] = [Frustum(_POLE, color, base, height, radius, radius * rng.uniform(0.5, 1.0))]
    top = base + [0.0, 0.0, height - 0.05]
    if rng.random() < 0.7:
        end = top + rng.uniform(0.8, 2.8) * towards + [0.0, 0.0, rng.uniform(0.0, 0.6)]
        solids.append(bar(_POLE, color, top, end, 0.08))
        head = variant_id("pole", GLOWING) if rng.random() < 0.3 else _POLE
        solids.append(bar(head, (0.9, 0.95, 1.0), end, end + 0.6 * towards, 0.14))
    return solids


def plain_pole(base: np.ndarray, rng: np.random.Generator) -> list[Solid]:
    """Poles of wood, of wires, of flags."""
    radius = rng.uniform(0.03, 0.16)
    color = (0.2, 0.28, 0.36) if rng.random() < 0.3 else grey(rng)
    return [Frustum(_POLE, color, base, rng.uniform(2.0, 9.0), radius, radius * rng.uniform(0.6, 1.0))]


def sign(base: np.ndarray, facing_rad: float, rng: np.random.Generator) -> list[Solid]:
    """One or two signs on a post, seen from the front or the back."""
    top_m, radius = rng.uniform(1.6, 2.9), rng.uniform(0.025, 0.05)
    solids: list[Solid] = [Frustum(_POLE, grey(rng, 0.3, 0.7), base, top_m + 0.4, radius, radius)]
    size, center = float(np.exp(rng.uniform(np.log(0.4), np.log(1.5)))), base + [0.0, 0.0, top_m]
    solids += board(center, facing_rad, str(rng.choice(list(_CORNERS))), (size, size), radius + 0.02, rng)
    if rng.random() < 0.3:
        below = center - [0.0, 0.0, 0.5 * size + 0.25]
        solids += board(below, facing_rad, "rectangle", (size, 0.35), radius + 0.02, rng)
    return solids


def large_sign(base: np.ndarray, facing_rad: float, rng: np.random.Generator) -> list[Solid]:
    """A board of some metres on two posts: directions, place names."""
    size, low_m = (rng.uniform(1.2, 4.0), rng.uniform(0.7, 2.5)), rng.uniform(0.6, 2.4)
    right, color, radius = np.array([np.sin(facing_rad), -np.cos(facing_rad), 0.0]), grey(rng, 0.3, 0.7), 0.05
    solids: list[Solid] = [
        Frustum(_POLE, color, base + share * size[0] * right, low_m + size[1], radius, radius)
        for share in (-0.35, 0.35)
    ]
    center = base + [0.0, 0.0, low_m + 0.5 * size[1]]
    return solids + board(center, facing_rad, "rectangle", size, radius + 0.02, rng)


def board(
    center: np.ndarray,
    facing_rad: float,
    shape: str,
    size_m: tuple[float, float],
    before_m: float,
    rng: np.random.Generator,
) -> list[Solid]:
    """A face with a rim, strokes on it, and a grey back.

    Args:
        center: middle of it.
        facing_rad: heading it looks towards.
        shape: circle, triangle, rectangle, octagon, diamond.
        size_m: width and height.
        before_m: how far it stands before its post.
        rng: colours and strokes.
    """
    normal = np.array([np.cos(facing_rad), np.sin(facing_rad), 0.0])
    right, up = np.array([-normal[1], normal[0], 0.0]), np.array([0.0, 0.0, 1.0])
    corners = _CORNERS[shape]
    turn = {"triangle": rng.choice([90.0, -90.0]), "rectangle": 45.0, "octagon": 22.5}.get(shape, 0.0)
    angle = np.radians(turn) + 2.0 * np.pi * np.arange(corners) / corners
    stretch = np.sqrt(2.0) if shape == "rectangle" else 1.0
    outline = 0.5 * stretch * np.column_stack([size_m[0] * np.cos(angle), size_m[1] * np.sin(angle)])
    face, rim, ink = (_FACES[int(rng.integers(len(_FACES)))] for _ in range(3))

    def plate(flat: np.ndarray, at_m: float, color: tuple) -> Plate:
        return Plate(_SIGN, color, center + at_m * normal + flat[:, :1] * right + flat[:, 1:] * up)

    solids: list[Solid] = [plate(outline, before_m - 0.01, _GREY_BACK), plate(outline, before_m, rim)]
    solids.append(plate(outline * rng.uniform(0.7, 1.0), before_m + 0.004, face))
    for _ in range(int(rng.integers(0, 5))):
        middle, half = rng.uniform(-0.22, 0.22, 2) * size_m, rng.uniform(0.02, 0.14, 2) * size_m
        box = middle + half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        solids.append(plate(box, before_m + 0.008, ink))
    return solids


def signal(center: np.ndarray, facing_rad: float, rng: np.random.Generator) -> list[Solid]:
    """The housing of a traffic light, one of its lamps lit."""
    light, height = CLASS_IDS["traffic_light"], rng.uniform(0.7, 1.1)
    wide = rng.uniform(0.25, 0.38)
    shade = (0.05, 0.06, 0.05) if rng.random() < 0.75 else (0.08, 0.55, 0.75)
    R = rotation_about_z(facing_rad)
    solids: list[Solid] = [Box(light, shade, center, (0.25, wide, height), R)]
    lit = int(rng.integers(3))
    for k, color in enumerate(((0.1, 0.1, 1.0), (0.1, 0.7, 1.0), (0.6, 0.9, 0.2))):
        spot = center + 0.14 * R[:, 0] + [0.0, 0.0, (1 - k) * height / 3.2]
        kind, tone = (
            (variant_id("traffic_light", GLOWING), color) if k == lit else (light, tuple(0.25 * np.array(color)))
        )
        solids.append(Ball(kind, tone, spot, 0.32 * wide))
    return solids


def signal_mast(base: np.ndarray, towards: np.ndarray, facing_rad: float, rng: np.random.Generator) -> list[Solid]:
    """A post with traffic lights, often with an arm over the street."""
    color, tall = grey(rng), rng.random() < 0.6
    height = rng.uniform(5.0, 6.5) if tall else rng.uniform(2.8, 3.8)
    solids: list[Solid] = [Frustum(_POLE, color, base, height, 0.09, 0.07)]
    solids += signal(base + [0.0, 0.0, rng.uniform(2.2, 2.7)] + 0.25 * towards, facing_rad, rng)
    if tall:
        top, reach = base + [0.0, 0.0, height - 0.3], rng.uniform(3.0, 8.0)
        solids.append(bar(_POLE, color, top, top + reach * towards, 0.12))
        for share in (0.55, 0.95):
            solids += signal(top + share * reach * towards - [0.0, 0.0, 0.2], facing_rad, rng)
    return solids


def gantry(left: np.ndarray, right: np.ndarray, facing_rad: float, rng: np.random.Generator) -> list[Solid]:
    """A beam over the street with large boards."""
    color, height = grey(rng, 0.4, 0.8), rng.uniform(5.5, 7.0)
    lift = np.array([0.0, 0.0, height])
    solids: list[Solid] = [Frustum(_POLE, color, base, height, 0.16, 0.14) for base in (left, right)]
    solids.append(bar(_POLE, color, left + lift, right + lift, 0.2))
    for share in rng.uniform(0.15, 0.85, int(rng.integers(1, 4))):
        size = rng.uniform(1.8, 4.0), rng.uniform(1.2, 2.4)
        center = left + share * (right - left) + lift + [0.0, 0.0, 0.2]
        solids += board(center, facing_rad + np.pi * rng.integers(2), "rectangle", size, 0.2, rng)
    return solids


def tree(base: np.ndarray, rng: np.random.Generator) -> list[Solid]:
    """A trunk with a crown of several balls."""
    height, wide, vegetation = rng.uniform(1.5, 5.0), rng.uniform(0.9, 2.6), CLASS_IDS["vegetation"]
    bark = (0.12, 0.16, 0.2) if rng.random() < 0.7 else (0.4, 0.45, 0.45)
    radius = rng.uniform(0.06, 0.3)
    solids: list[Solid] = [Frustum(variant_id("vegetation", 1), bark, base, height + 0.5 * wide, radius, 0.7 * radius)]
    for _ in range(int(rng.integers(3, 8))):
        off = rng.normal(0.0, 0.45 * wide, 3) * [1.0, 1.0, 0.7]
        center = base + [0.0, 0.0, height + wide] + off
        solids.append(Ball(vegetation, (0.1, 0.4, 0.2), center, wide * rng.uniform(0.35, 0.75)))
    return solids


def trunk(base: np.ndarray, rng: np.random.Generator) -> list[Solid]:
    """A tree of a wood, whose crown is far above."""
    radius, bark = rng.uniform(0.05, 0.3), tuple((rng.uniform(0.05, 0.5) * np.array([0.8, 0.9, 1.0])).tolist())
    tall = rng.uniform(4.0, 14.0)
    return [Frustum(variant_id("vegetation", 1), bark, base, tall, radius, radius * rng.uniform(0.5, 0.9))]


def bush(base: np.ndarray, rng: np.random.Generator) -> list[Solid]:
    """Low green."""
    size = rng.uniform(0.3, 1.2)
    return [
        Ball(
            CLASS_IDS["vegetation"],
            (0.1, 0.4, 0.2),
            base + rng.normal(0.0, size, 3) * [1, 1, 0.2],
            size * rng.uniform(0.5, 1.0),
        )
        for _ in range(3)
    ]


def front(base: np.ndarray, heading_rad: float, depth_side: float, rng: np.random.Generator) -> list[Solid]:
    """A house whose wall runs along the street."""
    width, height, depth = rng.uniform(8.0, 22.0), rng.uniform(3.0, 22.0), rng.uniform(6.0, 12.0)
    R = rotation_about_z(heading_rad)
    color = tuple(
        (rng.uniform(0.1, 0.85) * np.array([0.8, 0.9, 1.0]) * (1.0 + rng.normal(0.0, 0.12, 3))).clip(0.03, 0.95)
    )
    center = base + 0.5 * depth * depth_side * R[:, 1] + [0.0, 0.0, 0.5 * height - 1.0]
    building = CLASS_IDS["building"]
    solids: list[Solid] = [Box(building, color, center, (width, depth, height + 2.0), R)]
    for _ in range(int(rng.integers(0, 8))):  # pipes, pilasters, doors, shop windows: upright edges that are no posts
        x, wide = rng.uniform(-0.5, 0.5) * width, float(np.exp(rng.uniform(np.log(0.08), np.log(1.6))))
        tall = rng.uniform(0.5, 1.0) * height if wide < 0.5 else rng.uniform(1.8, 2.8)
        middle = base + x * R[:, 0] + [0.0, 0.0, 0.5 * tall]
        solids.append(Box(variant_id("building", 1), grey(rng, 0.03, 0.9), middle, (wide, 0.2, tall), R))
    return solids


def fence(start: np.ndarray, heading_rad: float, rng: np.random.Generator) -> list[Solid]:
    """Some metres of pickets or a hedge."""
    R, color = rotation_about_z(heading_rad), grey(rng, 0.05, 0.9)
    high, length = rng.uniform(0.7, 1.8), rng.uniform(3.0, 6.0)
    if rng.random() < 0.4:
        middle = start + 0.5 * length * R[:, 0] + [0.0, 0.0, 0.5 * high]
        return [Box(CLASS_IDS["vegetation"], (0.1, 0.4, 0.2), middle, (length, 0.6, high), R)]
    kind, pitch, thick = variant_id("wall", 1), rng.uniform(0.3, 1.2), rng.uniform(0.02, 0.09)
    solids: list[Solid] = [
        Box(kind, color, start + x * R[:, 0] + [0.0, 0.0, 0.5 * high], (thick, thick, high), R)
        for x in np.arange(0.0, length, pitch)
    ]
    along = start + 0.5 * length * R[:, 0]
    return solids + [Box(kind, color, along + [0.0, 0.0, z * high], (length, 0.04, 0.05), R) for z in (0.25, 0.9)]


def vehicle(
    base: np.ndarray,
    heading_rad: float,
    rng: np.random.Generator,
    kinds: tuple[float, float, float] = (0.7, 0.15, 0.15),
) -> list[Solid]:
    """A car, a van or a lorry (shares `kinds`) on dark wheels with rims, with glass, lamps and a plate."""
    R, lift = rotation_about_z(heading_rad), np.array([0.0, 0.0, 1.0])
    color = grey(rng, 0.03, 0.95) if rng.random() < 0.7 else tuple(rng.uniform(0.03, 0.8, 3))
    kind = int(rng.choice(3, p=kinds))
    length, width, height, cabin = ((4.4, 1.8, 0.8, 0.6), (5.0, 1.95, 1.9, 0.0), (9.0, 2.5, 3.2, 0.0))[kind]
    ground_m, shadow, rim = 0.28 if kind < 2 else 0.7, (0.02, 0.02, 0.02), grey(rng, 0.2, 0.9)

    def box(x: float, y: float, z: float, size: tuple, tone: tuple, variant: int = 0) -> Box:
        center = base + x * R[:, 0] + y * R[:, 1] + z * lift
        return Box(variant_id("vehicle", variant), tone, center, size, R)

    solids: list[Solid] = [box(0.0, 0.0, ground_m + 0.5 * height, (length, width, height), color)]
    if cabin:
        solids.append(box(-0.25, 0.0, ground_m + height + 0.5 * cabin, (2.5, 0.86 * width, cabin), (0.1, 0.09, 0.08)))
        solids.append(box(-0.25, 0.0, ground_m + height + cabin, (2.0, 0.82 * width, 0.08), color))
    else:
        solids.append(
            box(
                0.35 * length,
                0.0,
                ground_m + 0.7 * height,
                (0.31 * length, width + 0.02, 0.28 * height),
                (0.1, 0.09, 0.08),
            )
        )
    for x in (-0.32 * length, 0.32 * length):
        solids.append(box(x, 0.0, 0.2, (0.5, width - 0.1, 0.4), shadow))
        for side in (-0.5, 0.5):
            middle = base + x * R[:, 0] + side * (width + 0.02) * R[:, 1] + 0.33 * lift
            solids.append(_wheel(middle, 0.34, shadow, R))
            solids.append(_wheel(middle + 0.02 * side * R[:, 1], 0.2, rim, R))
    glow = GLOWING if rng.random() < 0.5 else 0
    for end, tone in ((-1.0, (0.1, 0.08, 0.7)), (1.0, (0.85, 0.9, 0.9))):
        for side in (-0.38, 0.38):
            solids.append(
                box(end * 0.5 * length, side * width, ground_m + 0.62 * min(height, 0.9), (0.06, 0.3, 0.18), tone, glow)
            )
        solids.append(box(end * 0.5 * length, 0.0, ground_m + 0.25, (0.05, 0.5, 0.11), (0.85, 0.85, 0.85)))
    return solids


def _wheel(center: np.ndarray, radius_m: float, color: tuple, R_map_car: np.ndarray) -> Plate:
    """A disc at the side of a vehicle."""
    angle = 2.0 * np.pi * np.arange(12) / 12
    outline = center + radius_m * (np.cos(angle)[:, None] * R_map_car[:, 0] + np.sin(angle)[:, None] * R_map_car[:, 2])
    return Plate(_VEHICLE, color, outline)


def rail(points: np.ndarray, rng: np.random.Generator) -> list[Solid]:
    """A guard rail or a low wall through ground points [n 3]."""
    kind, color = CLASS_IDS["guardrail"], grey(rng, 0.3, 0.7)
    lift, thick = (np.array([0.0, 0.0, 0.6]), 0.28) if rng.random() < 0.7 else (np.array([0.0, 0.0, 0.4]), 0.8)
    solids: list[Solid] = []
    for a, b in pairwise(points):
        way = b - a
        size = (float(np.linalg.norm(way)) + 0.05, 0.08 if thick < 0.5 else 0.3, thick)
        solids.append(Box(kind, color, 0.5 * (a + b) + lift, size, _tilted(way)))
        if thick < 0.5:
            solids.append(Box(kind, color, a + [0.0, 0.0, 0.3], (0.08, 0.1, 0.7), _tilted(way)))
    return solids
