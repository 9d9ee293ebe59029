"""The four sides of what is painted as a strip: both ends, both long sides (room: mapping; host).

In: an element. Out: Strip: its middle, direction, length and width; the element with other ones.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.maps import MapElement

NUM_SIDES = 4
"""First end, last end, right, left."""
_LEAST_M = 0.04
"""No strip is narrower or shorter."""


class Strip(NamedTuple):
    """A dash, a bar or a piece of a line, seen from above."""

    middle: Float[np.ndarray, " 2"]
    """[m]"""
    along: Float[np.ndarray, " 2"]
    """Unit direction."""
    length_m: float
    width_m: float

    @property
    def normals(self) -> Float[np.ndarray, "4 2"]:
        """Outward, of each side."""
        left = np.array([-self.along[1], self.along[0]])
        return np.stack([-self.along, self.along, -left, left])


def strip_of(element: MapElement) -> Strip | None:
    """The strip that an element is, None for other outlines and for what has no width."""
    if not element.is_painted:
        return None
    xy = element.points[:, :2]
    if not element.closed:
        across_m, ends = element.width_m, xy[[0, -1]]
    elif len(xy) == 4:
        middles = 0.5 * (xy + np.roll(xy, -1, axis=0))
        pairs = middles[[3, 1]], middles[[0, 2]]
        ends, wide = sorted(pairs, key=lambda pair: -np.linalg.norm(pair[1] - pair[0]))
        across_m = float(np.linalg.norm(wide[1] - wide[0]))
    else:
        return None
    step = ends[1] - ends[0]
    length_m = float(np.linalg.norm(step))
    if across_m <= 0.0 or length_m < 1e-6:
        return None
    return Strip(ends.mean(axis=0), step / length_m, length_m, across_m)


def side_of(outward: Float[np.ndarray, "n 2"], along: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
    """Which side of a strip with these directions borders with these outward normals belong to."""
    forward = (outward * along).sum(axis=1)
    leftward = along[:, 0] * outward[:, 1] - along[:, 1] * outward[:, 0]
    is_end = np.abs(forward) > np.abs(leftward)
    return np.where(is_end, forward > 0, 2 + (leftward > 0))


def resized(element: MapElement, longer_m: float, wider_m: float) -> MapElement:
    """A strip that is longer and wider by so much; its middle stays."""
    strip = strip_of(element)
    if strip is None:
        return element
    left = np.array([-strip.along[1], strip.along[0]])
    away = element.points[:, :2] - strip.middle
    by = max(longer_m, _LEAST_M - strip.length_m) / strip.length_m
    points = element.points.copy()
    points[:, :2] += by * np.outer(away @ strip.along, strip.along)
    width_m = max(strip.width_m + wider_m, _LEAST_M)
    if not element.closed:
        return replace(element, points=points, width_m=width_m)
    points[:, :2] += (width_m / strip.width_m - 1.0) * np.outer(away @ left, left)
    return replace(element, points=points)
