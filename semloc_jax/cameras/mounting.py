"""Where a camera sits on a vehicle, from what one measures with a rule (room: cameras; host).

In: position [m] and three angles [deg]. Out: T_base_cam.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from semloc_jax.geometry.rigid import pose_from

_R_BODY_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A camera that looks along base x, upright."""


def mounted(
    position_m: Sequence[float | int], yaw_deg: float | int = 0, down_deg: float | int = 0, roll_deg: float | int = 0
) -> Float[np.ndarray, "4 4"]:
    """T_base_cam [4 4] of a camera that looks `yaw_deg` to the left of straight ahead and `down_deg` below the horizon.

    Args:
        position_m: Centre of the lens in the base frame [m]: x forward of the rear axle, y to the left, z above ground.
        yaw_deg: 0 looks ahead, 90 to the left, -90 to the right, 180 back.
        down_deg: Tilt towards the road.
        roll_deg: Turn about the line of sight.

    >>> T_base_cam = sj.mounted((1.6, 0.0, 1.4), down_deg=3.0)
    >>> T_base_cam[:3, 2].round(3)  # the line of sight: ahead and a little down
    array([ 0.999,  0.   , -0.052])
    """
    (cy, cp, cr), (sy, sp, sr) = (turn(np.radians([yaw_deg, down_deg, roll_deg])) for turn in (np.cos, np.sin))
    yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    down = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return pose_from(yaw @ down @ roll @ _R_BODY_CAM, position_m)
