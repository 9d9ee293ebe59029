"""Signs that a drive cannot see though it passes them (room: mapping; host).

In: a drive with its correction, places and faces of things. Out: which of them it saw from the front; which hang above
the road.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from semloc_jax.evaluation.map_shapes import POSTS
from semloc_jax.mapping.crowd.correction import Correction
from semloc_jax.mapping.crowd.fusion import Fused
from semloc_jax.maps import MapElement

_FAR_M, _AHEAD, _FRONT = 40.0, 0.5, 0.3
"""How far a sign is read; cosines of its direction ahead of the car and of the car off its face; ours."""
_HIGH_M = 4.5
"""What hangs higher lets every vehicle pass below."""


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


def hangs(fused: Fused, elements: Sequence[MapElement]) -> Bool[np.ndarray, " n"]:
    """Which things hang above the road, by what lies on the ground nearest to them."""
    low = [np.array([*e.points[:, :2].mean(axis=0), e.points[:, 2].min()]) for e in elements]
    ground = [p for p, e in zip(low, elements, strict=True) if e.label not in POSTS]
    ground += [p for line in fused.drives[0].placed_lines for p in line.placed] if fused.drives else []
    if not ground or not low:
        return np.zeros(len(elements), dtype=bool)
    feet, own = np.array(ground), np.array(low)
    return own[:, 2] - feet[cKDTree(feet[:, :2]).query(own[:, :2])[1], 2] > _HIGH_M
