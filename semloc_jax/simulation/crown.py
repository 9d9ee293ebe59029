"""Ground with a built road on it: crown, crossfall to both sides, lean in bends (room: simulation; host).

In: the ground, the line of the road. Out: CrownedSurface.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from semloc_jax.simulation.path import PlanePath
from semloc_jax.simulation.surface import Surface

_CELL_M = 0.5
_MARGIN_M = 60.0
_ROUNDING_M = 0.3
"""The crown is rounded over about this width."""
_LEAN_M, _MOST_LEAN = 4.0, 0.03
"""A road leans by this times its curvature, at most so much: 2 % in a bend of 200 m radius."""
_GRADIENT_M = 0.05


@dataclass(frozen=True)
class CrownedSurface(Surface):
    """The ground plus the profile of a road: it falls by `fall` to both sides of its crown and leans into its bends.

    Args:
        base: the ground without the road.
        first_xy: corner of a grid [m].
        left_m: distance to the left of the crown, at its nodes [m].
        lean: rise per metre to the left that a bend adds, at its nodes.
        fall: share by which the road falls to each side.
        half_width_m: where the fall ends; beyond, the verge is as high as the edge.
    """

    base: Surface
    first_xy: Float[np.ndarray, "2"]
    left_m: Float[np.ndarray, "i j"]
    lean: Float[np.ndarray, "i j"]
    fall: float
    half_width_m: float

    @classmethod
    def along(
        cls, base: Surface, path: PlanePath, crown_d_m: float, fall: float, half_width_m: float
    ) -> "CrownedSurface":
        """The surface of a road.

        Args:
            base: the ground without it.
            path: a line along it.
            crown_d_m: where the crown is, to the left of the line.
            fall: share by which the road falls to each side.
            half_width_m: of the road about its crown.
        """
        s = np.arange(path.s_m[0], path.s_m[-1], 1.0)
        line, heading = path.at(s), path.heading_at(s)
        first_xy = line.min(axis=0) - _MARGIN_M
        size = np.ceil((line.max(axis=0) + _MARGIN_M - first_xy) / _CELL_M).astype(int) + 1
        xy = first_xy + _CELL_M * np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1)
        nearest = cKDTree(line).query(xy.reshape(-1, 2))[1]
        # From the nearest place along the line, then across from there.
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)[nearest]
        s_near = s[nearest] + ((xy.reshape(-1, 2) - line[nearest]) * ahead).sum(axis=1)
        foot, turned = path.at(s_near), path.heading_at(s_near)
        away = xy.reshape(-1, 2) - foot
        left_m = -np.sin(turned) * away[:, 0] + np.cos(turned) * away[:, 1] - crown_d_m
        curvature = np.interp(s_near, s, np.gradient(heading, s))
        lean = -np.clip(_LEAN_M * curvature, -_MOST_LEAN, _MOST_LEAN)
        return cls(base, first_xy, left_m.reshape(size), lean.reshape(size), fall, half_width_m)

    @property
    def max_slope(self) -> float:
        # The lean changes along the road as well, over tens of metres.
        return self.base.max_slope + self.fall + 1.5 * float(np.abs(self.lean).max())

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        cell = np.stack([x.ravel() - self.first_xy[0], y.ravel() - self.first_xy[1]]) / _CELL_M
        left_m = map_coordinates(self.left_m, cell, order=1, mode="nearest").reshape(x.shape)
        lean = map_coordinates(self.lean, cell, order=1, mode="nearest").reshape(x.shape)
        left_m = np.clip(left_m, -self.half_width_m, self.half_width_m)
        profile = lean * left_m - self.fall * (np.hypot(left_m, _ROUNDING_M) - _ROUNDING_M)
        return self.base.height(x, y) + profile

    def normal(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        x, y = np.asarray(xy, np.float64).T
        here = self.height(x, y)
        gradient = [self.height(x + _GRADIENT_M, y) - here, self.height(x, y + _GRADIENT_M) - here]
        normal = np.column_stack([*(-np.array(gradient) / _GRADIENT_M), np.ones(len(x))])
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)
