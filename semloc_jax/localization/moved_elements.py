"""Whether elements of one kind, or of one side of the way, taken alone, fit better beside the pose (room: localization;
host).

In: WatchState. Out: Suspicion for each kind; Moved: what the drive speaks for most.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.alignment.class_profiles import GROUPS
from semloc_jax.localization.watch_config import WatchConfig
from semloc_jax.localization.watch_sums import Suspicion, WatchState

_SIDES = GROUPS[2:]
"""Of the way. A road that was made wider is told by them; along the road each holds too little alone."""
CLASSES = tuple(
    f"{group}_{axis}" for group in GROUPS for axis in ("left", "ahead") if axis == "left" or group not in _SIDES
)
"""Suspicions that are no calibration: elements of one kind, or of one side of the way, fit better elsewhere."""


class Moved(NamedTuple):
    """Elements of one kind that, taken alone, fit elsewhere."""

    kind: str
    """One of `GROUPS`; empty where none are."""
    ahead_m: float
    left_m: float
    nats: float


NOTHING_MOVED = Moved("", 0.0, 0.0, 0.0)


def moved_elements(watch: WatchState, config: WatchConfig) -> Moved:
    """What the drive speaks for most."""
    if not len(watch.num):
        return NOTHING_MOVED
    most = max(classes_apart(watch, config), key=lambda s: s.nats)
    if most.nats < config.class_count_nats:
        return NOTHING_MOVED
    return Moved(most.name.split("_")[0], float(most.moved[0]), float(most.moved[1]), most.nats)


def classes_apart(watch: WatchState, config: WatchConfig) -> list[Suspicion]:
    """Whether lines or posts, or what lies on one side, each alone, fit better beside the pose: they then do not
    belong to one map."""
    found = []
    for name in CLASSES:
        places, cost = profile_of(watch, name, config)
        is_here = near(places)
        best = int(np.argmin(np.where(is_here, np.inf, cost)))
        moved = np.zeros(3)
        moved[int(name.endswith("left"))] = places[best]
        better = float(np.min(cost[is_here]) - cost[best]) - config.class_gain_nats * float(watch.num_looks)
        found.append(Suspicion(name, float(places[best]), config.share * max(better, 0.0), moved))
    return found


def profile_of(
    watch: WatchState, name: str, config: WatchConfig
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Places ahead or to the left [m] where one of `CLASSES` was looked at, and what all frames cost there [nats]."""
    group, axis = name.split("_")
    num_aside = len(_places(config.aside_m))
    of_axis = slice(num_aside) if axis == "left" else slice(num_aside, None)
    costs = watch.profiles.reshape(len(GROUPS), -1)[GROUPS.index(group)]
    return moves(config)[of_axis, int(axis == "left")], costs[of_axis]


def near(places_m: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which places are the pose itself, for what masks tell."""
    return np.abs(places_m) <= 1.5 * (places_m[1] - places_m[0])


def moves(config: WatchConfig) -> Float[np.ndarray, "n 3"]:
    """Where lines and posts are compared: aside first, then ahead; forward [m], left [m], turned [rad]."""
    aside, ahead = _places(config.aside_m), _places(config.ahead_m)
    found = np.zeros((len(aside) + len(ahead), 3))
    found[: len(aside), 1], found[len(aside) :, 0] = aside, ahead
    return found


def _places(reach: tuple[float, float]) -> np.ndarray:
    num = round(reach[0] / reach[1])
    return reach[1] * np.arange(-num, num + 1)
