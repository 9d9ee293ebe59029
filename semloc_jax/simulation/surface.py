"""The ground of a simulated scene: a smooth height field (room: simulation; host).

In: slopes and waves. Out: heights, ray hits, the pose of a vehicle that stands on it.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from semloc_jax.geometry.rigid import pose_from

_MAX_STEPS = 200
_TOLERANCE = 1e-7
"""Height above ground over distance at which a ray counts as arrived: far below a millionth of a pixel."""
_SECANT_M = 0.5
"""Steps up to this length may follow the last two heights: ground bends too little to hide a crest in between."""


class Surface(ABC):
    """A height over every place of the map frame [m]."""

    @property
    @abstractmethod
    def max_slope(self) -> float:
        """Upper bound of the steepness."""

    @abstractmethod
    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height [m] at places of any shape."""

    @abstractmethod
    def normal(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Unit upward normals."""

    def drape(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """The places lifted onto the surface."""
        return np.column_stack([xy, self.height(xy[:, 0], xy[:, 1])])

    def hit(
        self,
        origin: Float[np.ndarray, "3"],
        ray: Float[np.ndarray, "n 3"],
        range_m: float,
        start_m: Float[np.ndarray, " n"] | None = None,
    ) -> Float[np.ndarray, " n"]:
        """Distance along each unit ray to its FIRST hit, inf where there is none within `range_m`.

        A step is the longest that cannot cross a surface of bounded slope, so that no crest is jumped over; near the
        ground it follows the secant.

        Args:
            origin: where the rays start.
            ray: unit directions.
            range_m: how far to look.
            start_m: distance up to which each ray is known to be free.
        """
        distance = np.full(len(ray), np.inf)
        closing = self.max_slope * np.hypot(ray[:, 0], ray[:, 1]) - ray[:, 2]
        active = np.flatnonzero(closing > 1e-4)
        if not len(active):
            return distance
        dx, dy, dz = ray[active].T
        rate = closing[active]
        t = np.zeros(len(active)) if start_m is None else start_m[active].copy()
        step, before = np.zeros(len(active)), np.zeros(len(active))
        for number in range(_MAX_STEPS):
            above = origin[2] + t * dz - self.height(origin[0] + t * dx, origin[1] + t * dy)
            arrived = np.abs(above) <= _TOLERANCE * np.maximum(t, 1.0)
            if number == 0:
                arrived |= above <= 0.0
            distance[active[arrived]] = t[arrived]
            go_on = ~arrived & (t < range_m)
            if not go_on.any():
                break
            if not go_on.all():
                active, t, above, step, before = (a[go_on] for a in (active, t, above, step, before))
                dx, dy, dz, rate = dx[go_on], dy[go_on], dz[go_on], rate[go_on]
            step, before = _step(above, before, step, rate), above
            t = t + step
        return distance

    def stand(
        self,
        xy: Float[np.ndarray, "n 2"],
        yaw_rad: Float[np.ndarray, " n"],
        wheelbase_m: float = 2.8,
        track_m: float = 1.6,
    ) -> Float[np.ndarray, "n 4 4"]:
        """T_map_base of a vehicle whose rear axle is above `xy`: the plane of its four wheel contacts."""
        forward = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
        left = np.column_stack([-np.sin(yaw_rad), np.cos(yaw_rad)])
        wheels = np.array(
            [xy + a * forward + b * left for a in (0.0, wheelbase_m) for b in (-0.5 * track_m, 0.5 * track_m)]
        )
        z = self.height(wheels[..., 0], wheels[..., 1])
        grade = (z[2:].mean(axis=0) - z[:2].mean(axis=0)) / wheelbase_m
        bank = (z[1::2].mean(axis=0) - z[::2].mean(axis=0)) / track_m
        ahead = np.column_stack([forward, grade])
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        up = np.cross(ahead, np.column_stack([left, bank]))
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        return pose_from(np.stack([ahead, np.cross(up, ahead), up], axis=2), np.column_stack([xy, z[:2].mean(axis=0)]))


def _step(above: np.ndarray, before: np.ndarray, last: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Step along the ray [m]: the safe distance, or the secant step where that is short."""
    safe = above / rate
    fall = before - above
    secant = np.where(np.abs(fall) > 1e-15, above * last / np.where(fall == 0.0, 1.0, fall), np.inf)
    is_near = (last != 0.0) & (np.abs(secant) < _SECANT_M)
    return np.where(is_near & ((above < 0.0) | (secant > safe)), secant, safe)


@dataclass(frozen=True)
class WaveSurface(Surface):
    """z = slope . xy + sum_k amplitude_k sin(wave_k . xy + phase_k), in the map frame [m].

    Args:
        slope: rise per metre towards x and y.
        amplitude_m: height of each wave.
        wave: wave vectors [rad/m].
        phase_rad: phases.
    """

    slope: Float[np.ndarray, "2"]
    amplitude_m: Float[np.ndarray, " k"]
    wave: Float[np.ndarray, "k 2"]
    phase_rad: Float[np.ndarray, " k"]

    @property
    def max_slope(self) -> float:
        return float(np.linalg.norm(self.slope) + np.abs(self.amplitude_m) @ np.linalg.norm(self.wave, axis=1))

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        z = self.slope[0] * x + self.slope[1] * y
        for amplitude, (kx, ky), phase in zip(self.amplitude_m, self.wave, self.phase_rad, strict=True):
            z = z + amplitude * np.sin(kx * x + ky * y + phase)
        return z

    def normal(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        gradient = np.tile(self.slope, (len(xy), 1))
        for amplitude, wave, phase in zip(self.amplitude_m, self.wave, self.phase_rad, strict=True):
            gradient = gradient + amplitude * np.cos(xy @ wave + phase)[:, None] * wave
        normal = np.column_stack([-gradient, np.ones(len(xy))])
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def rolling_surface(rng: np.random.Generator, grade: float = 0.015, camber: float = 0.025) -> WaveSurface:
    """A seeded surface: grade along x, camber along y, and two long waves of some decimetres."""
    direction = rng.uniform(0.0, 2.0 * np.pi, 2)
    length_m = np.array([rng.uniform(90.0, 130.0), rng.uniform(45.0, 60.0)])
    wave = 2.0 * np.pi / length_m[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    slope = np.array([rng.uniform(-grade, grade), camber * rng.choice([-1.0, 1.0])])
    return WaveSurface(slope, np.array([0.25, 0.06]), wave, rng.uniform(0.0, 2.0 * np.pi, 2))
