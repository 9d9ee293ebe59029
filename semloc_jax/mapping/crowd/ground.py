"""The ground as a base map has it (room: mapping; host).

In: Fused. Out: its height at places: what lies on the road lies where the survey has the road.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from semloc_jax.evaluation.map_shapes import POSTS
from semloc_jax.mapping.crowd.fusion import Fused

_NEAREST = 3


class Ground(NamedTuple):
    """Points that lie on it."""

    tree: cKDTree | None
    """From above; None without a base map."""
    z_m: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, found: Fused) -> "Ground":
        """Everything that is painted in the base map."""
        if not found.drives or not found.drives[0].sights.is_base:
            return cls(None, np.zeros(0))
        base = found.drives[0]
        flat = [e.points for e in base.sights.things.elements if e.label not in POSTS]
        points = np.concatenate([np.zeros((0, 3)), *flat, *(line.placed for line in base.placed_lines)])
        return cls(cKDTree(points[:, :2]), points[:, 2]) if len(points) else cls(None, np.zeros(0))

    def height_m(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """The mean of the nearest points, by their distance; no number without any."""
        if self.tree is None or not len(xy):
            return np.full(len(xy), np.nan)
        apart_m, near = self.tree.query(xy, k=[*range(1, min(_NEAREST, len(self.z_m)) + 1)])
        weight = 1.0 / np.maximum(apart_m, 0.01)
        return (weight * self.z_m[near]).sum(axis=1) / weight.sum(axis=1)
