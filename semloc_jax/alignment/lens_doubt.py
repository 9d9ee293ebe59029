"""Whether a frame fits better through other lenses (room: alignment; host).

In: cameras; the cost of the best pose through others, and where it is. Out: LensDoubt, FaultMode of each kind of lens.
A wrong focal length moves near and far borders of a frame by different pixels, which no pose mends: where the frame
shows both, it says so. What moves all of them alike (a camera that looks aside, a shifted image) one frame cannot tell.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from semloc_jax.alignment.fault_modes import PLANE, FaultConfig, FaultMode, lens_mode, sign_mode
from semloc_jax.cameras import Rig
from semloc_jax.cameras.other_lenses import FOCAL_SHARE, longer, wider, with_distortion
from semloc_jax.geometry import rigid


class ThroughLens(NamedTuple):
    """The best pose of a frame through given cameras."""

    cost: float
    """[nats]"""
    T_map_base: np.ndarray


@dataclass(frozen=True)
class LensDoubt:
    """The other lens that a frame fits best through.

    Attributes:
        lens_nats: by how much better; 0 where the stated lens fits best.
        lens: what is other about it.
    """

    lens_nats: float = 0.0
    lens: str = ""


def doubted(
    rig: Rig, solved_through: Callable[[Rig], ThroughLens], covariance: np.ndarray, config: FaultConfig
) -> tuple[LensDoubt, list[FaultMode]]:
    """The lens that a frame speaks for most, and where the vehicle would be with each kind of them.

    Args:
        rig: Cameras as stated.
        solved_through: The best pose near the one found, through given cameras.
        covariance: Of the pose: forward [m], left [m], heading [rad].
        config: How often lenses are wrong.
    """
    stated, found, modes = solved_through(rig), [LensDoubt()], []

    def beside(solved: ThroughLens) -> np.ndarray:
        return rigid.log(rigid.inverse(stated.T_map_base) @ solved.T_map_base)[list(PLANE)]

    for change, words in ((longer, "focal lengths"), (wider, "horizontal focal lengths")):
        sides = [solved_through(change(rig, side * FOCAL_SHARE)) for side in (1.0, -1.0)]
        up, down = (stated.cost - side.cost for side in sides)
        moved = np.array([beside(side) for side in sides])
        modes.append(lens_mode((up, down), moved, covariance, FOCAL_SHARE, f"other {words}", config))
        # A frame that has not found its own best place yet gains by any second solve.
        if min(up, down) <= 0.0:
            side = "longer" if up > down else "shorter"
            found.append(LensDoubt(max(up, down), f"{words} that are {100 * FOCAL_SHARE:.1f} % {side}"))
    other = with_distortion(rig, -1.0)
    if other is not None:
        solved, words = solved_through(other), "the distortion with the other sign"
        found.append(LensDoubt(stated.cost - solved.cost, words))
        modes.append(sign_mode(stated.cost - solved.cost, beside(solved), covariance, words, config))
    return max(found, key=lambda doubt: np.nan_to_num(doubt.lens_nats, nan=-np.inf)), modes
