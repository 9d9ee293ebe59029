"""Signs that a drive cannot see though it passes them (room: mapping; host).

In: the way of a drive, places and faces of things. Out: which of them turned their face to it.
"""

import numpy as np
from jaxtyping import Bool, Float

_FAR_M, _AHEAD, _FRONT = 40.0, 0.5, 0.3
"""How far a sign is read; cosines of its direction ahead of the car and of the car off its face; ours."""


def passes_its_face(
    way: Float[np.ndarray, "k 2"], centre: Float[np.ndarray, "n 2"], faces: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Whether each thing had its face to a place that it was ahead of; zeros for a thing without a face, which has it.

    Args:
        way: that passes, in the map [m].
        centre: of the things there [m].
        faces: horizontal directions that they look in.
    """
    has_none = np.linalg.norm(faces, axis=1) < 1e-6
    heading = np.gradient(way, axis=0)
    heading /= np.maximum(np.linalg.norm(heading, axis=1, keepdims=True), 1e-9)
    offset = centre[:, None] - way[None]
    apart_m = np.linalg.norm(offset, axis=2)
    is_ahead = (offset * heading).sum(axis=2) > _AHEAD * apart_m
    is_front = -(offset * faces[:, None]).sum(axis=2) > _FRONT * apart_m
    return has_none | ((apart_m < _FAR_M) & is_ahead & is_front).any(axis=1)
