"""The road around a prior, wherever the vehicle may stand (room: alignment; host).

In: a map, a place, how far around it. Out: RoadPatch, which puts poses onto the road at their own place.
One plane for all is off by a degree some lanes aside, where the road has a crown or is banked: a pose there would be
refused for its tilt.
"""

from dataclasses import dataclass

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.maps import SemanticMap

_LEAST_STEP_M, _MOST_STEPS = 4.0, 3
"""Planes are fitted on a grid with at least this step, to so many steps to each side."""


@dataclass(frozen=True)
class RoadPatch:
    """Planes of the road on a square grid, relative to the local origin.

    Attributes:
        first_xy: corner of the grid, float64[2] [m].
        step_m: distance of its nodes.
        height_m: of the road at each node, float64[k k].
        slope: rise per metre towards x and y, float64[k k 2].
    """

    first_xy: np.ndarray
    step_m: float
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
        steps = int(np.clip(np.ceil(half_m / _LEAST_STEP_M), 1, _MOST_STEPS))
        step_m = half_m / steps
        offsets = np.arange(-steps, steps + 1) * step_m
        height_m, slope = np.zeros((len(offsets),) * 2), np.zeros((len(offsets), len(offsets), 2))
        heading_rad = float(np.arctan2(T_map_base[1, 0], T_map_base[0, 0]))
        own_slope = -T_map_base[:2, 2] / T_map_base[2, 2]
        for i, x in enumerate(offsets):
            for j, y in enumerate(offsets):
                xy = T_map_base[:2, 3] + (x, y)
                try:
                    T = semantic_map.road_pose(*xy, heading_rad)
                    height_m[i, j], slope[i, j] = T[2, 3], -T[:2, 2] / T[2, 2]
                except SemlocError:
                    height_m[i, j], slope[i, j] = T_map_base[2, 3] + own_slope @ (x, y), own_slope
        first_xy = frame.from_map(T_map_base[:2, 3] + offsets[0], np.float64)
        return cls(first_xy, step_m, height_m - frame.origin_map[2], slope)

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
        last = len(self.height_m) - 1
        grid = np.clip((xy - self.first_xy) / self.step_m, 0.0, last - 1e-9)
        cell = grid.astype(int)
        share = grid - cell
        height_m, slope = np.zeros(len(xy)), np.zeros((len(xy), 2))
        for di in (0, 1):
            for dj in (0, 1):
                i, j = cell[:, 0] + di, cell[:, 1] + dj
                weight = np.abs(1 - di - share[:, 0]) * np.abs(1 - dj - share[:, 1])
                node_xy = self.first_xy + self.step_m * np.column_stack([i, j])
                rise_m = (self.slope[i, j] * (xy - node_xy)).sum(axis=1)
                height_m += weight * (self.height_m[i, j] + rise_m)
                slope += weight[:, None] * self.slope[i, j]
        return height_m, slope
