"""A trajectory moved onto its reference as a whole (room: evaluation; host).

In: estimated and reference trajectories. Out: the moved trajectory and the motion that was taken out.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float

from semloc_jax.evaluation.trajectory import Trajectory, associate
from semloc_jax.geometry.umeyama import umeyama

Alignment = Literal["none", "se2", "se3"]


def aligned(
    estimate: Trajectory, reference: Trajectory, alignment: Alignment, max_difference_s: float = 0.02
) -> tuple[Trajectory, Float[np.ndarray, "4 4"]]:
    """The trajectory that one rigid motion brings closest to its reference, by the positions that belong together.

    For trajectories in a frame of their own, such as odometry or a map that was built without satellites. What a
    localizer reports in a given map is judged without it: its offset is an error.

    Args:
        estimate: Poses in a frame of their own.
        reference: True poses.
        alignment: `se2` moves in the plane and turns about the vertical, `se3` moves and turns freely, `none` nothing.
        max_difference_s: Poses belong together when their times differ by no more than this.

    Returns:
        The moved poses, and the motion: moved = motion @ estimate. It is the identity where no times agree.
    """
    motion = np.eye(4)
    finite = np.isfinite(estimate.T_map_base).all(axis=(1, 2))
    index_est, index_ref = associate(estimate.time_s[finite], reference.time_s, max_difference_s)
    if alignment != "none" and len(index_est):
        dim = 2 if alignment == "se2" else 3
        p_ref = reference.T_map_base[index_ref, :dim, 3]
        found = umeyama(p_ref, estimate.T_map_base[finite][index_est][:, :dim, 3])
        motion[:dim, :dim], motion[:dim, 3] = found.R_a_b, found.t_a_b
    return Trajectory(estimate.time_s, motion @ estimate.T_map_base), motion
