"""A curved line in the plane by arc length (room: simulation; host).

In: curvature along the line. Out: places and headings at distance s and lateral offset.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class PlanePath:
    """Line sampled densely by arc length.

    Args:
        s_m: increasing arc length.
        xy: places in the map frame [m].
        heading_rad: direction of the tangent, continuous.
    """

    s_m: Float[np.ndarray, " n"]
    xy: Float[np.ndarray, "n 2"]
    heading_rad: Float[np.ndarray, " n"]

    def at(self, s_m: Float[np.ndarray, " k"], lateral_m: Float[np.ndarray, " k"] | float = 0.0) -> np.ndarray:
        """Places [k 2] at arc length `s_m`, `lateral_m` to the left."""
        heading = self.heading_at(s_m)
        left = np.column_stack([-np.sin(heading), np.cos(heading)])
        center = np.column_stack([np.interp(s_m, self.s_m, self.xy[:, axis]) for axis in range(2)])
        return center + np.asarray(lateral_m)[..., None] * left

    def heading_at(self, s_m: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Headings at arc length."""
        return np.interp(s_m, self.s_m, self.heading_rad)


def winding_path(
    rng: np.random.Generator, start_m: float, end_m: float, max_curvature: float = 0.006, start_heading_rad: float = 0.0
) -> PlanePath:
    """A seeded line whose curvature swings smoothly within +-`max_curvature` [1/m]; (0, 0) is at s = 0."""
    s = np.arange(start_m, end_m, 0.05)
    curvature = np.zeros_like(s)
    for length_m in (70.0, 160.0):
        curvature += 0.5 * max_curvature * np.sin(2.0 * np.pi * s / length_m + rng.uniform(0.0, 2.0 * np.pi))
    return path_from_curvature(s, curvature, start_heading_rad)


def path_from_curvature(s_m: np.ndarray, curvature: np.ndarray, start_heading_rad: float) -> PlanePath:
    """Integral of curvature [1/m] at `s_m`; place (0, 0) and `start_heading_rad` are at s = 0."""
    step = np.diff(s_m)
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * step)])
    heading += start_heading_rad - np.interp(0.0, s_m, heading)
    middle = 0.5 * (heading[1:] + heading[:-1])
    xy = np.vstack([np.zeros(2), np.cumsum(step[:, None] * np.column_stack([np.cos(middle), np.sin(middle)]), axis=0)])
    xy -= [np.interp(0.0, s_m, xy[:, 0]), np.interp(0.0, s_m, xy[:, 1])]
    return PlanePath(s_m, xy, heading)
