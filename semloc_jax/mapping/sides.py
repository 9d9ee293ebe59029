"""The four sides of what lies on the road: both ends, both long sides (room: mapping; host).

In: an element. Out: Strip: its middle, direction, length and width; the element with other ones.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float, Int

from semloc_jax.mapping.sightings import UPRIGHT
from semloc_jax.maps import MapElement

NUM_SIDES = 4
"""First end, last end, right, left."""
_LEAST_M = 0.04
"""No strip is narrower or shorter."""


class Strip(NamedTuple):
    """A dash, a bar, a piece of a line, or the box around an arrow, seen from above."""

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
    """The strip that an element is or fills, None for what stands upright, is logical or has no width."""
    if element.label in UPRIGHT or element.is_logical:
        return None
    xy = element.points[:, :2]
    if not element.closed:
        across_m, ends = element.width_m, xy[[0, -1]]
    else:
        corners = xy if len(xy) == 4 else _box(xy)
        middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
        pairs = middles[[3, 1]], middles[[0, 2]]
        ends, wide = sorted(pairs, key=lambda pair: -np.linalg.norm(pair[1] - pair[0]))
        across_m = float(np.linalg.norm(wide[1] - wide[0]))
    step = ends[1] - ends[0]
    length_m = float(np.linalg.norm(step))
    if across_m < 1e-3 or length_m < 1e-3:
        return None
    return Strip(ends.mean(axis=0), step / length_m, length_m, across_m)


def _box(xy: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "4 2"]:
    """The corners of the smallest box around an outline."""
    box = shapely.oriented_envelope(shapely.MultiPoint(xy))
    return shapely.get_coordinates(box)[:4] if box.geom_type == "Polygon" else np.zeros((4, 2))


def side_of(
    outward: Float[np.ndarray, "n 2"], off_m: Float[np.ndarray, "n 2"], along: Float[np.ndarray, "n 2"]
) -> Int[np.ndarray, " n"]:
    """Which side of its strip each piece of a border goes with when the strip grows.

    Args:
        outward: normals of the border.
        off_m: from the middle of the strip.
        along: directions of the strips.
    """
    forward, leftward = _in_strip(outward, along)
    ahead_m, aside_m = _in_strip(off_m, along)
    return np.where(np.abs(forward) > np.abs(leftward), ahead_m > 0, 2 + (aside_m > 0))


def _in_strip(xy: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return (xy * along).sum(axis=1), along[:, 0] * xy[:, 1] - along[:, 1] * xy[:, 0]


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
