"""Marks on the road of six classes, drawn at random: what a classifier of marks learns from (room: simulation; host).

In: a class, a generator. Out: cells of the mark [m], x along the driving direction.
Sizes are ours, of the order of road marking manuals: dashes of 0.1 to 0.2 m by 1.5 to 6 m, zebra bars of 0.4 to 0.6 m,
stop lines of 0.3 to 0.6 m, arrows of 2 to 6 m, letters of 0.5 to 2.4 m, lines of slots of 0.08 to 0.15 m and bars at
their entrances of 0.6 to 1.6 m.
"""

from enum import IntEnum

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.perception.road_marks import CELL_M


class MarkKind(IntEnum):
    """The six classes of Road-SLAM."""

    ARROW = 0
    NUMBER = 1
    DASHED_LANE = 2
    CROSSWALK = 3
    OTHER = 4
    NONE = 5


_SIDE_M = 9.0
_FINE = 4
"""Drawn so many times finer than the cells, then read as a camera reads it: a cell is paint where most of it is."""
_FINE_M = CELL_M / _FINE
_ASIDE_DEG = 20.0
"""Marks of a lane that runs a little otherwise than the vehicle; ours."""
_LEAST_CELLS = 50
_LEAST_SHARE = 0.7
"""A mark that wear has cut to pieces is none of its class any more; ours."""


def mark_sample(kind: MarkKind, rng: np.random.Generator) -> Float[np.ndarray, "n 2"]:
    """The cells of one mark: drawn, turned, worn and read in cells; the largest piece that is left, n >= 50.

    Args:
        kind: its class.
        rng: generator; equal ones give equal marks.
    """
    while True:
        picture = np.zeros((round(_SIDE_M / _FINE_M),) * 2, np.uint8)
        _DRAW[kind](picture, rng)
        cells = _largest(_seen(picture, rng))
        drawn = np.count_nonzero(picture) / _FINE**2
        if len(cells) >= max(_LEAST_CELLS, _LEAST_SHARE * drawn if kind != MarkKind.NONE else 0.0):
            v, u = cells.T
            return np.column_stack([-v, -u]) * CELL_M


def _turned(points_m: np.ndarray, across: bool, rng: np.random.Generator) -> np.ndarray:
    """Points [m] (x ahead, y left) turned as a vehicle sees them."""
    angle = np.deg2rad(rng.uniform(-_ASIDE_DEG, _ASIDE_DEG)) + (np.pi / 2 if across else 0.0)
    angle += np.pi * rng.integers(2)
    c, s = np.cos(angle), np.sin(angle)
    return points_m @ np.array([[c, s], [-s, c]])


def _fill(picture: np.ndarray, points_m: np.ndarray, value: int = 255) -> None:
    uv = 0.5 * _SIDE_M - points_m[:, ::-1]
    cv2.fillPoly(picture, [np.rint(uv / _FINE_M).astype(np.int32)], value)


def _bar(length_m: float, width_m: float, at_m: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 0.5
    return corners * [length_m, width_m] + at_m


def _draw_arrow(picture: np.ndarray, rng: np.random.Generator) -> None:
    length_m, stem_m = rng.uniform(2.0, 6.0), rng.uniform(0.12, 0.22)
    head_m, half_m = rng.uniform(0.25, 0.45) * length_m, rng.uniform(0.25, 0.6)
    turn = rng.integers(4)  # straight twice as often as left and right
    angle = np.deg2rad(rng.uniform(-_ASIDE_DEG, _ASIDE_DEG)) + np.pi * rng.integers(2)
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, s], [-s, c]])
    stem = _bar(length_m - head_m + 0.1, stem_m, (-0.5 * head_m, 0.0))
    front_m = 0.5 * length_m - head_m
    if turn < 2:
        _fill(picture, stem @ R)
        _fill(picture, np.array([(front_m, -half_m), (0.5 * length_m, 0.0), (front_m, half_m)]) @ R)
        return
    side = 1.0 if turn == 2 else -1.0
    reach_m = rng.uniform(0.5, 0.9)
    _fill(picture, stem @ R)
    _fill(picture, _bar(stem_m * 2, reach_m, (front_m, side * 0.5 * reach_m)) @ R)
    head = np.array([(front_m - half_m, reach_m), (front_m, reach_m + 0.8 * half_m + 0.2), (front_m + half_m, reach_m)])
    _fill(picture, head * [1.0, side] @ R)


_SEGMENTS = (((0, 1), (1, 1)), ((1, 1), (1, 0.5)), ((1, 0.5), (1, 0)), ((0, 0), (1, 0)), ((0, 0), (0, 0.5)))
_SEGMENTS += (((0, 0.5), (0, 1)), ((0, 0.5), (1, 0.5)))
_DIGITS = ("abcdef", "abged", "abgcd", "fgbc", "afgcd", "afgedc", "abc", "abcdefg", "abcfgd", "abcefg", "cdefg", "adef")
"""Segments a to g of the digits but 1, a straight stroke, and of A, B and C; each is one piece."""


def _draw_number(picture: np.ndarray, rng: np.random.Generator) -> None:
    height_m = rng.uniform(0.5, 2.4)
    width_m = height_m * rng.uniform(0.3, 0.65)
    stroke_m = rng.uniform(0.1, 0.18) * min(height_m, 1.2)
    strokes = _DIGITS[rng.integers(len(_DIGITS))]
    angle = np.deg2rad(rng.uniform(-_ASIDE_DEG, _ASIDE_DEG)) + 0.5 * np.pi * rng.integers(4)
    c, s = np.cos(angle), np.sin(angle)
    for name in strokes:
        ends = (np.array(_SEGMENTS["abcdefg".index(name)]) - 0.5) * [width_m, height_m]
        ends = ends[:, ::-1] @ np.array([[c, s], [-s, c]])
        uv = np.rint((0.5 * _SIDE_M - ends[:, ::-1]) / _FINE_M).astype(int)
        thick = max(round(max(stroke_m, 1.5 * CELL_M) / _FINE_M), 1)
        cv2.line(picture, tuple(map(int, uv[0])), tuple(map(int, uv[1])), 255, thick)


def _draw_dash(picture: np.ndarray, rng: np.random.Generator) -> None:
    _fill(picture, _turned(_bar(rng.uniform(1.5, 6.0), rng.uniform(0.1, 0.2)), False, rng))


def _draw_crosswalk(picture: np.ndarray, rng: np.random.Generator) -> None:
    _fill(picture, _turned(_bar(rng.uniform(2.0, 5.0), rng.uniform(0.4, 0.6)), False, rng))


def _draw_other(picture: np.ndarray, rng: np.random.Generator) -> None:
    """Stop lines, lines of slots, pieces of solid lines, diamonds, triangles; corners, tees and combs of slots.

    Dividers with a bar at the entrance, and these bars alone, too.
    """
    which = rng.integers(11)
    if which == 0:
        _fill(picture, _turned(_bar(rng.uniform(2.2, 8.0), rng.uniform(0.3, 0.6)), True, rng))
    elif which == 1:
        _fill(picture, _turned(_bar(rng.uniform(2.0, 6.0), rng.uniform(0.08, 0.15)), True, rng))
    elif which == 2:
        _fill(picture, _turned(_bar(rng.uniform(7.0, 8.5), rng.uniform(0.1, 0.25)), False, rng))
    elif which == 3:
        a, b = rng.uniform(0.8, 1.8), rng.uniform(0.3, 0.6)
        _fill(picture, _turned(np.array([(-a, 0), (0, -b), (a, 0), (0, b)]), False, rng))
    elif which == 4:
        a, b = rng.uniform(0.5, 1.5), rng.uniform(0.3, 0.8)
        _fill(picture, _turned(np.array([(-a, -b), (a, 0.0), (-a, b)]), False, rng))
    elif which < 8:
        _draw_slots(picture, rng)
    else:
        _draw_barred_divider(picture, rng)


def _draw_barred_divider(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A divider of slots with a bar across its end, at any heading; of some, traffic leaves the bar alone to see."""
    width_m, bar_m = rng.uniform(0.08, 0.15), rng.uniform(0.6, 1.6)
    length_m = rng.uniform(0.0, 5.5) * (rng.random() < 0.6)
    angle = rng.uniform(0.0, 2 * np.pi)
    R = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    middle_m = 0.5 * length_m
    _fill(picture, _bar(width_m, bar_m, (-middle_m, rng.uniform(-0.1, 0.1) * bar_m)) @ R)
    _fill(picture, _bar(length_m + width_m, width_m) @ R)


def _draw_slots(picture: np.ndarray, rng: np.random.Generator) -> None:
    """Dividers at a back or entrance line: a corner, a tee, or a comb, at any heading."""
    width_m, pitch_m, length_m = rng.uniform(0.08, 0.15), rng.uniform(2.2, 2.8), rng.uniform(0.2, 4.0)
    angle = rng.uniform(0.0, 2 * np.pi)
    R = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    places = ((0.0,), (-0.5,), (-0.5, 0.5), (-1.0, 0.0, 1.0))[rng.integers(4)]
    back_m = rng.uniform(0.4, 3.0) if len(places) == 1 else pitch_m * (len(places) - 1)
    _fill(picture, _bar(back_m + width_m, width_m) @ R)
    for place in places:
        at_m = place * (back_m if len(places) == 1 else pitch_m)
        _fill(picture, _bar(width_m, length_m, (at_m, 0.5 * length_m)) @ R)


def _draw_none(picture: np.ndarray, rng: np.random.Generator) -> None:
    """What no paint is: glare, puddles, patches of asphalt, with ragged borders."""
    size = picture.shape[0] // 8
    noise = cv2.GaussianBlur(rng.normal(size=(size, size)).astype(np.float32), (0, 0), rng.uniform(2.0, 5.0))
    noise += 0.35 * noise.std() * rng.normal(size=noise.shape).astype(np.float32)
    noise = (noise > np.quantile(noise, rng.uniform(0.8, 0.93))).astype(np.uint8) * 255
    picture[:] = np.maximum(picture, cv2.resize(noise, picture.shape[::-1], interpolation=cv2.INTER_NEAREST))


_DRAW = {
    MarkKind.ARROW: _draw_arrow,
    MarkKind.NUMBER: _draw_number,
    MarkKind.DASHED_LANE: _draw_dash,
    MarkKind.CROSSWALK: _draw_crosswalk,
    MarkKind.OTHER: _draw_other,
    MarkKind.NONE: _draw_none,
}


def _seen(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The picture as a mask in cells: wobbling borders, worn spots, a blur along the line of sight."""
    size = picture.shape[1] // _FINE, picture.shape[0] // _FINE
    share = cv2.resize(picture.astype(np.float32) / 255.0, size, interpolation=cv2.INTER_AREA)
    share = cv2.GaussianBlur(share, (0, 0), sigmaX=rng.uniform(0.3, 0.8), sigmaY=rng.uniform(0.3, 1.5))
    wobble = cv2.GaussianBlur(rng.normal(size=share.shape).astype(np.float32), (0, 0), 2.0)
    worn = cv2.GaussianBlur(rng.normal(size=share.shape).astype(np.float32), (0, 0), 4.0)
    gone = worn > np.quantile(worn, 1.0 - rng.uniform(0.0, 0.04))
    return (share + rng.uniform(0.0, 0.15) * wobble / wobble.std() > 0.5) & ~gone


def _largest(shown: np.ndarray) -> np.ndarray:
    """Rows and columns of the largest piece."""
    num, label, stats, _ = cv2.connectedComponentsWithStats(shown.astype(np.uint8), connectivity=8)
    if num < 2:
        return np.zeros((0, 2), int)
    return np.argwhere(label == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))
