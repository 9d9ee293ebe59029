"""Signs that a drive cannot see though it passes them (room: mapping; host).

In: a drive with its correction, places and faces of things. Out: which of them turned their face to it.
"""

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.mapping.crowd.correction import Correction

_FAR_M, _AHEAD, _FRONT = 40.0, 0.5, 0.3
"""How far a sign is read; cosines of its direction ahead of the car and of the car off its face; ours."""


def shows_its_face(
    drive: Correction, centre: Float[np.ndarray, "n 2"], faces: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Whether each thing had its face to a place that it was ahead of; zeros for a thing without a face, which has it.

    Args:
        drive: whose way passes.
        centre: of the things in the map [m].
        faces: horizontal directions that they look in.
    """
    has_none = np.linalg.norm(faces, axis=1) < 1e-6
    way = drive.moved(drive.sights.way)
    heading = np.gradient(way, axis=0)
    heading /= np.maximum(np.linalg.norm(heading, axis=1, keepdims=True), 1e-9)
    offset = centre[:, None] - way[None]
    apart_m = np.linalg.norm(offset, axis=2)
    is_ahead = (offset * heading).sum(axis=2) > _AHEAD * apart_m
    is_front = -(offset * faces[:, None]).sum(axis=2) > _FRONT * apart_m
    return has_none | ((apart_m < _FAR_M) & is_ahead & is_front).any(axis=1)
