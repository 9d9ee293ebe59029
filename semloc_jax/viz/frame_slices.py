"""Slices through the cost of one frame, ready to be drawn (room: viz).

In: a localizer, the masks of a frame, a pose. Out: CostSlice by class, in metres and degrees.
"""

from collections.abc import Sequence

import numpy as np

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.analysis.landscape import frame_landscape
from semloc_jax.cameras import Rig
from semloc_jax.viz.cost_slices import DIRECTIONS, CostSlice


def slices_of_frame(
    localizer: FrameLocalizer,
    masks: Sequence[np.ndarray],
    rig: Rig,
    T_map_base: np.ndarray,
    directions: tuple[str, str],
    extent: tuple[float, float],
    level: int = 1,
    steps: tuple[int, int] = (61, 61),
) -> dict[str, CostSlice]:
    """Slices of one frame around a pose: `all` classes together, then each mask channel in view alone.

    Args:
        localizer: Map, class table and configuration.
        masks: Class ids of every camera of the rig.
        rig: Cameras of the masks.
        T_map_base: Pose in the middle, in the map frame.
        directions: Two of x, y, z, roll, pitch, yaw.
        extent: Half width along each [m or deg].
        level: Level of the cost maps, 0 is the coarsest.
        steps: Number of poses along each; a single one stands in the middle.

    Raises:
        SemlocError: wrong directions, or a level that the cost maps do not have.
    """
    offsets = [
        np.linspace(-half, half, num) if num > 1 else np.zeros(1) for half, num in zip(extent, steps, strict=True)
    ]
    in_si = [
        np.deg2rad(offset) if DIRECTIONS.get(direction, ("", ""))[1] == "deg" else offset
        for direction, offset in zip(directions, offsets, strict=True)
    ]
    costs = frame_landscape(localizer, masks, rig, T_map_base, directions, *in_si, level)
    return {name: CostSlice(directions, *offsets, cost) for name, cost in costs.items()}
