"""The sides of what lies on the road, each of which may be off on its own (room: mapping; host).

In: an element. Out: Sides: their outward directions and middles; the element with some of them moved out.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.mapping.sightings import UPRIGHT
from semloc_jax.maps import MapElement

NUM_SIDES = 12
"""Outlines with more corners are as they were drawn."""
_LEAST_M = 0.04
"""No line is narrower."""
_CLEAR_SINE = 0.2
"""Sides that meet at a sharper angle have no clear corner."""


class Sides(NamedTuple):
    """Sides of an element, seen from above.

    A line has its first end, its last end, its right and its left; an outline has the sides between its corners.
    """

    outward: Float[np.ndarray, "s 2"]
    """Unit directions."""
    middle: Float[np.ndarray, "s 2"]
    """[m]"""
    is_line: bool

    @property
    def shapes(self) -> Float[np.ndarray, "s q"]:
        """How far out each side goes [m], for all that is no motion of the whole: an orthonormal basis."""
        arm = self.middle - self.middle.mean(axis=0)
        turn = arm[:, 0] * self.outward[:, 1] - arm[:, 1] * self.outward[:, 0]
        rigid = np.column_stack([self.outward, turn])
        left, size, _ = np.linalg.svd(rigid)
        return left[:, np.count_nonzero(size > 1e-6) :]


def sides_of(element: MapElement) -> Sides | None:
    """The sides of an element; None for what stands upright, is logical, has no width or too many corners."""
    if element.label in UPRIGHT or element.is_logical:
        return None
    xy = element.points[:, :2]
    if not element.closed:
        return _line_sides(xy, element.width_m)
    if not 3 <= len(xy) <= NUM_SIDES:
        return None
    step = np.roll(xy, -1, axis=0) - xy
    length_m = np.linalg.norm(step, axis=1)
    if length_m.min() < 1e-3:
        return None
    x, y = (xy - xy[0]).T
    is_left_turning = x @ np.roll(y, -1) - y @ np.roll(x, -1) > 0.0
    outward = np.stack([step[:, 1], -step[:, 0]], axis=1) / length_m[:, None]
    return Sides(outward if is_left_turning else -outward, xy + 0.5 * step, False)


def _line_sides(xy: np.ndarray, width_m: float) -> Sides | None:
    step = xy[-1] - xy[0]
    length_m = float(np.linalg.norm(step))
    if width_m < 1e-3 or length_m < 1e-3:
        return None
    along = step / length_m
    left = np.array([-along[1], along[0]])
    half = 0.5 * width_m * left
    middle = 0.5 * (xy[0] + xy[-1])
    return Sides(np.stack([-along, along, -left, left]), np.stack([xy[0], xy[-1], middle - half, middle + half]), True)


def side_at(sides: Sides, xy: Float[np.ndarray, "n 2"], outward: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
    """Which side pieces of the border belong to.

    Args:
        sides: of their element.
        xy: where they are [m].
        outward: their normals.
    """
    if sides.is_line:  # it may be bent, its sides are not
        return (outward @ sides.outward.T).argmax(axis=1)
    off_m = np.abs(np.einsum("nsi,si->ns", xy[:, None] - sides.middle, sides.outward))
    # Sides in one line are told by where they are.
    far_m = np.linalg.norm(xy[:, None] - sides.middle, axis=2)
    return (off_m + 0.01 * far_m).argmin(axis=1)


def moved_out(element: MapElement, out_m: Float[np.ndarray, " s"]) -> MapElement:
    """An element whose sides lie so far out from where they were [m]."""
    sides = sides_of(element)
    if sides is None:
        return element
    points = element.points.copy()
    if sides.is_line:
        along, length_m = sides.outward[1], float((points[-1, :2] - points[0, :2]) @ sides.outward[1])
        ahead = ((points[:, :2] - points[0, :2]) @ along) / length_m
        points[:, :2] += np.outer(ahead * out_m[1] - (1.0 - ahead) * out_m[0], along)
        return replace(element, points=points, width_m=max(element.width_m + float(out_m[2] + out_m[3]), _LEAST_M))
    for k in range(len(points)):
        points[k, :2] += _corner(sides.outward[k - 1], sides.outward[k], float(out_m[k - 1]), float(out_m[k]))
    return replace(element, points=points)


def _corner(before: np.ndarray, after: np.ndarray, before_m: float, after_m: float) -> np.ndarray:
    """How a corner moves when the sides that meet there move out."""
    sine = before[0] * after[1] - before[1] * after[0]
    if abs(sine) < _CLEAR_SINE:
        return 0.5 * (before_m * before + after_m * after)
    return np.array([before_m * after[1] - after_m * before[1], after_m * before[0] - before_m * after[0]]) / sine
