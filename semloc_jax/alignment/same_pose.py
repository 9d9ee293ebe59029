"""Whether two poses are the same: one distance, and the limit of each use of it (room: alignment; pure JAX).

In: poses T_map_base. Out: their distance, a number without unit; numpy arrays stay numpy.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

UNIT_M, UNIT_DEG = 0.5, 1.0
"""One unit is half a metre on the ground or one degree of heading: about as far as the basin of a solve reaches."""
ONE_OPTIMUM = 0.1
"""Solves that end nearer to each other than this (5 cm, 0.1 deg) found one optimum; it counts once. Ours."""
ONE_TRACK = 0.6
"""Answers of a search that are farther apart (0.3 m, 0.6 deg) are followed as tracks of their own. Ours."""
ONE_PLACE = 1.2
"""Modes of one frame nearer than this (0.6 m, 1.2 deg) are one place: their mean is the pose, their spread is in its
covariance. Ours."""


def units_apart(
    T_a: Float[Array, "*a 4 4"] | Float[np.ndarray, "*a 4 4"], T_b: Float[Array, "*b 4 4"] | Float[np.ndarray, "*b 4 4"]
) -> Any:
    """Distance of poses on the ground: the root of (metres / 0.5 m)^2 + (degrees of heading / 1 deg)^2.

    Height, roll and pitch do not count: the road decides them.

    Args:
        T_a: Poses T_map_base; arrays of the host are compared in float64, far from the origin of the map, too.
        T_b: Others, of a shape that broadcasts.
    """
    xp = np if isinstance(T_a, np.ndarray) and isinstance(T_b, np.ndarray) else jnp
    step_m = T_a[..., :2, 3] - T_b[..., :2, 3]
    heading_a, heading_b = (xp.arctan2(T[..., 1, 0], T[..., 0, 0]) for T in (T_a, T_b))
    turn_rad = xp.mod(heading_a - heading_b + np.pi, 2 * np.pi) - np.pi
    return xp.sqrt(xp.sum(step_m**2, axis=-1) / UNIT_M**2 + (turn_rad / np.deg2rad(UNIT_DEG)) ** 2)
