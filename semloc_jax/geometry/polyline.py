"""Places along a polyline and the place nearest to a point (room: geometry; pure JAX, and numpy alike).

In: vertices [k d] without repeats, d = 2 or 3. Out: arc lengths, points, tangents, distances, in the library (numpy or
JAX) of the input.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

Points = Float[Array | np.ndarray, "k d"]
Numbers = Float[Array | np.ndarray, " n"]


class Foot(NamedTuple):
    """The place of a polyline that is nearest to a point."""

    s_m: Numbers
    """Arc length of the place."""
    distance_m: Numbers
    """Distance of the point from it."""
    lateral_m: Numbers
    """The same in the xy plane, positive where the point lies to the left of the direction of travel."""


def arc_length(points: Points) -> Float[Array | np.ndarray, " k"]:
    """Length along the line from its start to each vertex [m]."""
    xp = points.__array_namespace__()
    steps = xp.linalg.norm(points[1:] - points[:-1], axis=-1)
    return xp.concatenate([xp.zeros(1, dtype=steps.dtype), xp.cumsum(steps)])


def interpolate(points: Points, s_m: Numbers) -> Float[Array | np.ndarray, "n d"]:
    """Points at arc lengths `s_m`; before the start and past the end those of the ends."""
    xp = points.__array_namespace__()
    segment, share = _locate(points, s_m)
    share = xp.clip(share, 0, 1)[:, None]
    return points[segment] * (1 - share) + points[segment + 1] * share


def tangent(points: Points, s_m: Numbers) -> Float[Array | np.ndarray, "n d"]:
    """Unit direction of travel at arc lengths `s_m`; at a vertex that of the segment behind it."""
    xp = points.__array_namespace__()
    segment, _ = _locate(points, s_m)
    step = points[segment + 1] - points[segment]
    return step / xp.linalg.norm(step, axis=-1, keepdims=True)


def nearest(points: Points, queries: Float[Array | np.ndarray, "n d"]) -> Foot:
    """The nearest place of the line for each query point."""
    xp = points.__array_namespace__()
    step = points[1:] - points[:-1]
    offset = queries[:, None, :] - points[None, :-1, :]
    share = xp.clip(xp.sum(offset * step, axis=-1) / xp.sum(step * step, axis=-1), 0, 1)
    miss = offset - share[..., None] * step
    distance2 = xp.sum(miss * miss, axis=-1)
    row, best = xp.arange(len(queries)), xp.argmin(distance2, axis=1)
    left = step[best, 0] * offset[row, best, 1] - step[best, 1] * offset[row, best, 0]
    planar = xp.hypot(miss[row, best, 0], miss[row, best, 1])
    s_m = arc_length(points)[best] + share[row, best] * xp.linalg.norm(step[best], axis=-1)
    return Foot(s_m, xp.sqrt(distance2[row, best]), xp.copysign(planar, left))


def _locate(points: Points, s_m: Numbers) -> tuple[Array | np.ndarray, Array | np.ndarray]:
    """Segment that holds each arc length, and the share of it."""
    xp = points.__array_namespace__()
    knots = arc_length(points)
    segment = xp.clip(xp.searchsorted(knots, s_m, side="right") - 1, 0, len(points) - 2)
    return segment, (s_m - knots[segment]) / (knots[segment + 1] - knots[segment])
