"""The road around a prior, wherever the vehicle may stand (room: alignment; host).

In: a map, a place, how far around it. Out: RoadPatch, which puts poses onto the road at their own place.
One plane for all is off by a degree some lanes aside, where the road has a crown or is banked: a pose there would be
refused for its tilt.
"""

from dataclasses import dataclass

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
        xy = np.asarray(Ts[:, :2, 3], dtype=np.float64)
        heading = np.arctan2(Ts[:, 1, 0], Ts[:, 0, 0]).astype(np.float64)
        height_m, slope = self._at(xy)
        direction = np.column_stack([np.cos(heading), np.sin(heading)])
        forward = np.column_stack([direction, (slope * direction).sum(axis=1)])
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
        up = np.column_stack([-slope, np.ones(len(xy))])
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        T = np.tile(np.eye(4), (len(xy), 1, 1))
        T[:, :3, :3] = np.stack([forward, np.cross(up, forward), up], axis=2)
        T[:, :2, 3], T[:, 2, 3] = xy, height_m
        return T

    def _at(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Height float64[n] and slope float64[n 2], blended from the planes of the four nodes around."""
        last = np.array(self.height_m.shape) - 1
        grid = np.clip((xy - self.center_xy) @ self.axes.T / self.step_m + 0.5 * last, 0.0, last - 1e-9)
        cell = grid.astype(int)
        corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
        weight = np.abs(1 - corners - (grid - cell)[:, None]).prod(axis=-1)
        node = cell[:, None] + corners
        node_xy = self.center_xy + (node - 0.5 * last) * self.step_m @ self.axes
        i, j = node[..., 0], node[..., 1]
        slope = self.slope[i, j]
        height_m = self.height_m[i, j] + (slope * (xy[:, None] - node_xy)).sum(axis=-1)
        return (weight * height_m).sum(axis=1), (weight[..., None] * slope).sum(axis=1)
