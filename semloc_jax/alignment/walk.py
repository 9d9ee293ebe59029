"""Along the road through a place that was found, place by place (room: alignment; host).

In: a place, how far the prior may be wrong. Out: starts at all other places along the road that fit.
A random search meets some of the places that fit along a road, which are half a metre long each, and misses others. One
of them tells across and heading of all: what is left is a line, and all of it can be looked at.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.alignment.along_road import RoadPosterior
from semloc_jax.alignment.candidates import planar

WALK_SIGMAS = 3.0
LONGEST_WALK_M = 16.0
"""The road is looked at so many sigmas of the prior away, and no farther: two periods of most dashes."""
_NUM_OF_STRETCH = 3
"""Places that each stretch gives."""


def walked(
    T_local_base: Float[np.ndarray, "4 4"],
    sigma_m: float,
    reach_m: float,
    on_road: Callable[[np.ndarray], np.ndarray],
    road_through: Callable[[np.ndarray], RoadPosterior],
) -> Float[np.ndarray, "n 4 4"]:
    """The best places along the road through a pose, as far as the prior may be wrong.

    Args:
        T_local_base: The pose, relative to the local origin.
        sigma_m: Standard deviation of the prior along the road.
        reach_m: To both sides of a pose `road_through` looks so far.
        on_road: Poses [n 4 4] set on the road.
        road_through: Places along the road through a pose, each solved across and in heading.
    """
    num = int(min(WALK_SIGMAS * sigma_m, LONGEST_WALK_M) // (2.0 * reach_m))
    found = [np.zeros((0, 4, 4))]
    for way in (-1, 1):
        T = T_local_base
        for _ in range(num):
            # From where the last stretch ended, so that bends are followed.
            T = on_road(T @ planar(np.array([way * reach_m]), np.zeros(1), 0.0))[0]
            road = road_through(T)
            places = np.asarray(road.places, np.float64)
            if not np.isfinite(places).all():
                break
            found.append(places[best_along(np.asarray(road.log_masks, np.float64), _NUM_OF_STRETCH)])
            T = places[0 if way < 0 else -1]
    return np.concatenate(found)


def best_along(log_masks: Float[np.ndarray, " n"], num: int) -> Int[np.ndarray, " k"]:
    """The best places of a stretch that are better than both of their neighbours, or its best one."""
    known = np.where(np.isfinite(log_masks), log_masks, -np.inf)
    inner = np.flatnonzero((known[1:-1] > known[:-2]) & (known[1:-1] >= known[2:])) + 1
    inner = inner if len(inner) else np.array([int(known.argmax())])
    return inner[np.argsort(-known[inner], kind="stable")[:num]]
