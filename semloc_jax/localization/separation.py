"""How far the pose that goes out may be from the right one under one fault or another (room: localization; host).

In: suspected faults, each with the pose it would leave. Out: Separation, levels that hold under each, and the least
move of the pose with which they are within their alert limits.
Solution separation: the pose that fits with a fault and the one without it may both be right. A level reaches from the
pose that goes out to the farthest of them, so a pose between them has smaller levels than either.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.frame_levels import AS_LEVELS
from semloc_jax.evaluation.metrics import ErrorLimit
from semloc_jax.localization.integrity import LEVEL_UNITS, ProtectionLevels
from semloc_jax.localization.watch_config import WatchConfig

STAY = np.zeros(3)
"""The move of a pose that stays where it is."""


class Separation(NamedTuple):
    """How far the pose would be off under one fault, and what is told of it."""

    lateral_m: float
    longitudinal_m: float
    heading_deg: float
    cause: str
    side: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the right pose would be: positive to the left, ahead, turned to the left; 0 where it may be on either
    side."""


def separated(moved: Float[np.ndarray, "3"], cause: str, is_sided: bool = True) -> Separation:
    """The separation of a fault without which the pose is, and with which it would be `moved`.

    Args:
        moved: Forward [m], left [m], heading [rad].
        cause: What is told of it.
        is_sided: Whether the right pose would be there, not as far away on either side.
    """
    off = np.asarray(moved, np.float64)[AS_LEVELS] * LEVEL_UNITS
    side = np.sign(off) if is_sided else np.zeros(3)
    return Separation(*np.abs(off).tolist(), cause, tuple(side.tolist()))


def reach(faults: Sequence[Separation]) -> Float[np.ndarray, "2 3"]:
    """Where the right pose may be as seen from the pose without faults: least and most of left [m], ahead [m] and of
    the heading [deg]."""
    found = np.zeros((2, 3))
    for fault in faults:
        size, side = np.array(fault[:3]), np.array(fault.side)
        found[0] = np.minimum(found[0], np.where(side <= 0.0, -size, 0.0))
        found[1] = np.maximum(found[1], np.where(side >= 0.0, size, 0.0))
    return found


def remembered(
    before: Float[np.ndarray, "2 3"], found: Sequence[Separation], way_m: float, config: WatchConfig
) -> Float[np.ndarray, "2 3"]:
    """What was in doubt of late, as `reach`.

    A frame in which a fault happens not to show has not spoken against it.

    Args:
        before: At the frame before.
        found: What the frames up to this one speak for.
        way_m: Way since the frame before [m].
        config: Memory.
    """
    kept, now = np.exp(-way_m / config.doubt_memory_m) * before, reach(found)
    return np.array([np.minimum(kept[0], now[0]), np.maximum(kept[1], now[1])])


def lasting(doubted: Float[np.ndarray, "2 3"], found: Sequence[Separation]) -> list[Separation]:
    """What is remembered beyond that which is still spoken for; arguments as `remembered`."""
    cause = "what spoke against calibration, map or motion within the last metres has not been cleared yet"
    beyond = zip((-1.0, 1.0), doubted, reach(found), strict=True)
    return [
        Separation(*np.abs(far).tolist(), cause, (side, side, side))
        for side, far, now in beyond
        if (np.abs(far) > np.abs(now)).any()
    ]


def farthest(reached: Float[np.ndarray, "2 3"], move: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """How far the right pose may be from one that was moved; arguments as `least_move`."""
    return np.maximum(reached[1] - move, move - reached[0])


def least_move(
    own: ProtectionLevels, reached: Float[np.ndarray, "2 3"], room: tuple[float, float, float]
) -> Float[np.ndarray, "3"]:
    """The least move left [m] and ahead [m] of a pose with which its levels are within their room; nothing where none
    is needed or none helps. Headings are turned by what the way says, see `course`.

    Args:
        own: Levels without faults.
        reached: From `reach`.
        room: Left, ahead and for the heading.
    """
    left = np.array(room) - np.array(own)
    move = np.maximum(reached[1] - left, 0.0) + np.minimum(reached[0] + left, 0.0)
    return np.where((farthest(reached, move) <= left + 1e-9) & (np.arange(3) < 2), move, 0.0)


def second_moment(fault: Separation, move: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Mean squared error [m^2, m^2, deg^2] of a pose that was moved, where the fault is there as probably as not."""
    size, side = np.array(fault[:3]), np.array(fault.side)
    there = np.where(side == 0.0, np.square(size) + np.square(move), np.square(side * size - move))
    return 0.5 * (there + np.square(move))


def with_faults(own: ProtectionLevels, far: Float[np.ndarray, "3"]) -> ProtectionLevels:
    """Levels of a pose from which the right one may be so `far`."""
    return ProtectionLevels(*(np.array(own) + far).tolist())


def at_least(levels: ProtectionLevels, config: WatchConfig, seen: Float[np.ndarray, "3"] = STAY) -> ProtectionLevels:
    """Levels that leave room for faults that are too small to be seen; such a one and those that are seen are
    independent.

    Args:
        levels: Without that room.
        config: How much it is.
        seen: How far off faults that are seen leave the pose: left [m], ahead [m], heading [deg].
    """
    lateral_m, longitudinal_m, heading_deg = config.least_levels
    return ProtectionLevels(
        max(levels.lateral_m, float(np.hypot(lateral_m, seen[0]))),
        max(levels.longitudinal_m, float(np.hypot(longitudinal_m, seen[1]))),
        float(np.hypot(levels.heading_deg, heading_deg)),
    )


def room_in(limit: ErrorLimit, config: WatchConfig) -> tuple[float, float, float]:
    """What the alert limits leave to levels that `at_least` joins with others."""
    heading_deg = limit.heading_deg**2 - config.least_levels[2] ** 2
    return limit.lateral_m, limit.longitudinal_m, float(np.sqrt(max(heading_deg, 0.0)))


def causes(levels: ProtectionLevels, found: Sequence[Separation], limit: ErrorLimit) -> tuple[str, ...]:
    """A sentence for each fault that alone takes a level beyond its alert limit.

    Args:
        levels: Without faults.
        found: The faults.
        limit: The alert limits.
    """
    limits = (limit.lateral_m, limit.longitudinal_m, limit.heading_deg)
    return tuple(
        fault.cause
        for fault in found
        if any(level <= limit < level + more for level, more, limit in zip(levels, fault[:3], limits, strict=True))
    )
