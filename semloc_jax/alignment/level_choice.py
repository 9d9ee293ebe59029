"""Which level of the cost maps holds a pose (room: alignment; pure JAX).

In: share of the visible contour that is explained on each level. Out: index of the finest level that holds.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

MIN_INLIER_RATIO = 0.5
"""A finer level is left again where less than this share of the visible contour lies within its ramp. Ours."""


def holds(inlier_ratio: float | Float[Array, "*n"] | Float[np.ndarray, "*n"], least: float):
    """Whether a level holds a pose: a level finer than the scatter of the boundaries fits noise.

    Args:
        inlier_ratio: Share of the visible contour within the ramp of the level.
        least: Share that a level needs.
    """
    return inlier_ratio >= least


def finest_held(
    inlier_ratio: Float[Array, " level"] | Float[np.ndarray, " level"], least: float
) -> Int[Array, ""] | np.integer:
    """Index of the finest level that holds a pose; the coarsest one where none does.

    Args:
        inlier_ratio: Share of the visible contour within the ramp of each level, coarsest first.
        least: Share that a level needs.
    """
    xp = np if isinstance(inlier_ratio, np.ndarray) else jnp
    return xp.max(xp.where(holds(inlier_ratio, least), xp.arange(len(inlier_ratio)), 0))
