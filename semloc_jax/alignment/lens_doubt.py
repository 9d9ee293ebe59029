"""Whether a frame fits better through other lenses (room: alignment; host).

In: cameras, the cost of the best pose through others. Out: LensDoubt.
A wrong focal length moves near and far borders of a frame by different pixels, which no pose mends: where the frame
shows both, it says so. What moves all of them alike (a camera that looks aside, a shifted image) one frame cannot tell.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.cameras.other_lenses import FOCAL_SHARE, longer, wider, with_distortion


@dataclass(frozen=True)
class LensDoubt:
    """The other lens that a frame fits best through.

    Attributes:
        lens_nats: by how much better; 0 where the stated lens fits best.
        lens: what is other about it.
    """

    lens_nats: float = 0.0
    lens: str = ""


def doubted(rig: Rig, cost_through: Callable[[Rig], float]) -> LensDoubt:
    """The lens that a frame speaks for most.

    Args:
        rig: Cameras as stated.
        cost_through: Cost [nats] of the frame at its best pose near the one found, through given cameras.
    """
    stated, found = cost_through(rig), [LensDoubt()]
    for change, words in ((longer, "focal lengths"), (wider, "horizontal focal lengths")):
        up, down = (stated - cost_through(change(rig, side * FOCAL_SHARE)) for side in (1.0, -1.0))
        # A frame that has not found its own best place yet gains by any second solve.
        if min(up, down) <= 0.0:
            side = "longer" if up > down else "shorter"
            found.append(LensDoubt(max(up, down), f"{words} that are {100 * FOCAL_SHARE:.1f} % {side}"))
    other = with_distortion(rig, -1.0)
    if other is not None:
        found.append(LensDoubt(stated - cost_through(other), "the distortion with the other sign"))
    return max(found, key=lambda doubt: np.nan_to_num(doubt.lens_nats, nan=-np.inf))
