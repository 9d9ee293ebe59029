"""The road around a prior, wherever the vehicle may stand (room: alignment; host).

In: a map, a place, how far around it. Out: RoadPatch, which puts poses onto the road at their own place.
One plane for all is off by a degree some lanes aside, where the road has a crown or is banked: a pose there would be
refused for its tilt.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.maps import SemanticMap

_LEAST_STEPS_M, _MOST_STEPS = (4.0, 1.0), (3, 4)
"""Planes are fitted on a grid with at least these steps along and across the road, to so many steps to each side: a
crown lies within a metre, along the road little changes."""


@dataclass(frozen=True)
class RoadPatch:
    """Planes of the road on a grid along a heading, relative to the local origin.

    Attributes:
        center_xy: middle of the grid, float64[2] [m].
        axes: rows: along and across the road, float64[2 2].
        step_m: distance of the nodes along and across, float64[2].
        height_m: of the road at each node, float64[i j].
        slope: rise per metre towards x and y, float64[i j 2].
    """

    center_xy: np.ndarray
    axes: np.ndarray
    step_m: np.ndarray
    height_m: np.ndarray
    slope: np.ndarray

    @classmethod
    def around(cls, semantic_map: SemanticMap, T_map_base: np.ndarray, frame: LocalFrame, half_m: float) -> "RoadPatch":
        """The road within `half_m` of a pose on it.

        Args:
            semantic_map: the map.
            T_map_base: the pose, in the map frame; its plane stands in where the map has no road.
            frame: the local frame.
            half_m: half width of the patch.
        """
        steps = np.clip(np.ceil(half_m / np.array(_LEAST_STEPS_M)), 1, _MOST_STEPS).astype(int)
        heading_rad = float(np.arctan2(T_map_base[1, 0], T_map_base[0, 0]))
        axes = np.array([[np.cos(heading_rad), np.sin(heading_rad)], [-np.sin(heading_rad), np.cos(heading_rad)]])
        height_m, slope = np.zeros(2 * steps + 1), np.zeros((*(2 * steps + 1), 2))
        own_slope = -T_map_base[:2, 2] / T_map_base[2, 2]
        nodes = list(np.ndindex(*height_m.shape))
        away = [(np.array(node) / steps - 1.0) * half_m @ axes for node in nodes]
        poses = semantic_map.road_poses([T_map_base[:2, 3] + off for off in away], heading_rad)
        for node, off, T in zip(nodes, away, poses, strict=True):
            if T is None:
                height_m[node], slope[node] = T_map_base[2, 3] + own_slope @ off, own_slope
            else:
                height_m[node], slope[node] = T[2, 3], -T[:2, 2] / T[2, 2]
        center_xy = frame.from_map(T_map_base[:2, 3], np.float64)
        return cls(center_xy, axes, half_m / steps, height_m - frame.origin_map[2], slope)

    def place(self, Ts: np.ndarray) -> np.ndarray:
        """The poses with their x, y and heading kept and the rest from the road there, float64[n 4 4]."""
        x, y = np.asarray(Ts[:, :2, 3].T, dtype=np.float64)
        heading = np.arctan2(Ts[:, 1, 0], Ts[:, 0, 0]).astype(np.float64)
        height_m, by_x, by_y = self._at(x, y)
        c, s = np.cos(heading), np.sin(heading)
        rise = by_x * c + by_y * s
        forward = np.stack([c, s, rise]) / np.sqrt(1.0 + rise**2)
        up = np.stack([-by_x, -by_y, np.ones_like(c)]) / np.sqrt(1.0 + by_x**2 + by_y**2)
        T = np.zeros((len(x), 4, 4))
        T[:, :3, 0], T[:, :3, 2] = forward.T, up.T
        T[:, 0, 1] = up[1] * forward[2] - up[2] * forward[1]
        T[:, 1, 1] = up[2] * forward[0] - up[0] * forward[2]
        T[:, 2, 1] = up[0] * forward[1] - up[1] * forward[0]
        T[:, 0, 3], T[:, 1, 3], T[:, 2, 3], T[:, 3, 3] = x, y, height_m, 1.0
        return T

    @cached_property
    def _planes(self) -> np.ndarray:
        """Height at the local origin and slopes towards x and y of the plane of each node, float64[node 3]."""
        last = np.array(self.height_m.shape) - 1
        nodes = np.stack(np.meshgrid(*(np.arange(size + 1) for size in last), indexing="ij"), axis=-1)
        node_xy = self.center_xy + (nodes - 0.5 * last) * self.step_m @ self.axes
        at_origin = self.height_m - (self.slope * node_xy).sum(axis=-1)
        return np.concatenate([at_origin[..., None], self.slope], axis=-1).reshape(-1, 3)

    def _at(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Height and slopes towards x and y, float64[n] each, blended from the planes of the four nodes around."""
        last = np.array(self.height_m.shape) - 1
        away = (x - self.center_xy[0], y - self.center_xy[1])
        cells, shares = [], []
        for axis, step_m, count in zip(self.axes, self.step_m, last, strict=True):
            grid = np.clip((away[0] * axis[0] + away[1] * axis[1]) / step_m + 0.5 * count, 0.0, count - 1e-9)
            cells.append(grid.astype(int))
            shares.append(grid - cells[-1])
        (i, j), (down, across) = cells, shares
        first, plane = i * (last[1] + 1) + j, 0.0
        for row, along in ((0, 1.0 - down), (1, down)):
            for column, beside in ((0, 1.0 - across), (1, across)):
                plane = plane + self._planes[first + row * (last[1] + 1) + column] * (along * beside)[:, None]
        height_m, by_x, by_y = plane.T
        return height_m + by_x * x + by_y * y, by_x, by_y
