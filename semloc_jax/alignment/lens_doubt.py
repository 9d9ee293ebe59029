"""Whether a frame fits better through other lenses (room: alignment; host).

In: cameras; the cost of the best pose through others, and where it is. Out: LensDoubt, FaultMode of each kind of lens.
A wrong focal length moves near and far borders of a frame by different pixels, which no pose mends: where the frame
shows both, it says so. What moves all of them alike (a camera that looks aside, a shifted image) one frame cannot tell.
Two witnesses are asked. The cost that poses are solved by takes what masks have missed for far off, so that under poor
masks a lens gains by what it takes out of sight. The evidence knows what this frame's masks miss, but its own best pose
is another one. So a lens that the cost likes is none where the evidence excludes it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from semloc_jax.alignment.fault_modes import PLANE, FaultConfig, FaultMode, lens_mode, sign_mode
from semloc_jax.cameras import Rig
from semloc_jax.cameras.other_lenses import FOCAL_SHARE, longer, wider, with_distortion
from semloc_jax.geometry import rigid

_FULL_SHARE, _MOST_SHARE = 0.8, 0.99
"""Costs of masks that show so much of the map count in full: `VerdictConfig.max_lens_nats` was found with such ones.
More than the second is no share that a frame can tell. Ours."""


def told_share(coverage: float, inlier_ratio: float) -> float:
    """The share of a difference of search costs that is evidence of a lens.

    These costs stand for all of the map in view, also for what traffic hides. And contour that masks have missed costs
    as much as contour that speaks against the pose. Of masks that show a share p of the map it may cost -log(1 - p) and
    no more; otherwise a lens gains by moving what was missed onto the paint beside it.

    Args:
        coverage: share of the contour in view that falls on usable pixels.
        inlier_ratio: share of that which lies within the ramp of its class.
    """
    of_missed = np.log1p(-min(inlier_ratio, _MOST_SHARE)) / np.log1p(-_FULL_SHARE)
    return coverage * min(float(of_missed), 1.0)


class ThroughLens(NamedTuple):
    """The best pose of a frame through given cameras."""

    cost: float
    """[nats], as far as they are evidence."""
    T_map_base: np.ndarray
    nats: float = 0.0
    """By how much the evidence of the masks is higher than through the stated ones, as far as its scatter can be
    believed."""


@dataclass(frozen=True)
class LensDoubt:
    """The other lens that a frame fits best through.

    Attributes:
        lens_nats: by how much better; 0 where the stated lens fits best.
        lens: what is other about it.
        lens_left_nats: by how much the evidence of the masks is higher through that of the other lenses which it likes
            most; far below zero it excludes all of them.
    """

    lens_nats: float = 0.0
    lens: str = ""
    lens_left_nats: float = 0.0


def doubted(
    rig: Rig,
    solved_through: Callable[[Sequence[Rig]], Sequence[ThroughLens]],
    covariance: np.ndarray,
    config: FaultConfig,
) -> tuple[LensDoubt, list[FaultMode]]:
    """The lens that a frame speaks for most, and where the vehicle would be with each kind of them.

    Args:
        rig: Cameras as stated.
        solved_through: The best pose near the one found, through each of given cameras.
        covariance: Of the pose: forward [m], left [m], heading [rad].
        config: How often lenses are wrong.
    """
    kinds = ((longer, "focal lengths"), (wider, "horizontal focal lengths"))
    other = with_distortion(rig, -1.0)
    rigs = [change(rig, side * FOCAL_SHARE) for change, _ in kinds for side in (1.0, -1.0)]
    stated, *solved = solved_through([rig, *rigs] if other is None else [rig, *rigs, other])
    by_cost = [stated.cost - one.cost for one in solved]
    gain = [min(g, one.nats) if one.nats < -config.excluded_nats else g for g, one in zip(by_cost, solved, strict=True)]
    moved = [rigid.log(rigid.inverse(stated.T_map_base) @ one.T_map_base)[list(PLANE)] for one in solved]
    found, modes = [LensDoubt()], []
    for first, (_, words) in zip((0, 2), kinds, strict=True):
        up, down = gain[first : first + 2]
        sides = np.array(moved[first : first + 2])
        modes.append(lens_mode((up, down), sides, covariance, FOCAL_SHARE, f"other {words}", config))
        # A frame that has not found its own best place yet gains by any second solve.
        if min(by_cost[first : first + 2]) <= 0.0:
            side = "longer" if up > down else "shorter"
            found.append(LensDoubt(max(up, down), f"{words} that are {100 * FOCAL_SHARE:.1f} % {side}"))
    if other is not None:
        words = "the distortion with the other sign"
        found.append(LensDoubt(gain[-1], words))
        modes.append(sign_mode(gain[-1], moved[-1], covariance, words, config))
    doubt = max(found, key=lambda doubt: np.nan_to_num(doubt.lens_nats, nan=-np.inf))
    return replace(doubt, lens_left_nats=max(one.nats for one in solved)), modes
