"""The ground of a simulated scene: a smooth height field with slope and camber (room: datasets; host).

In: slopes and waves. Out: heights, ray hits, the pose of a vehicle that stands on it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_MAX_STEPS = 200
_TOLERANCE = 1e-7
"""Height above ground over distance at which a ray counts as arrived: far below a millionth of a pixel."""


@dataclass(frozen=True)
class Surface:
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
        """Upper bound of the steepness."""
        return float(np.linalg.norm(self.slope) + np.abs(self.amplitude_m) @ np.linalg.norm(self.wave, axis=1))

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height [m] at places of any shape."""
        z = self.slope[0] * x + self.slope[1] * y
        for amplitude, (kx, ky), phase in zip(self.amplitude_m, self.wave, self.phase_rad, strict=True):
            z = z + amplitude * np.sin(kx * x + ky * y + phase)
        return z

    def drape(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """The places lifted onto the surface."""
        return np.column_stack([xy, self.height(xy[:, 0], xy[:, 1])])

    def normal(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Unit upward normals."""
        gradient = np.tile(self.slope, (len(xy), 1))
        for amplitude, wave, phase in zip(self.amplitude_m, self.wave, self.phase_rad, strict=True):
            gradient = gradient + amplitude * np.cos(xy @ wave + phase)[:, None] * wave
        normal = np.column_stack([-gradient, np.ones(len(xy))])
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def hit(
        self, origin: Float[np.ndarray, "3"], ray: Float[np.ndarray, "n 3"], range_m: float
    ) -> Float[np.ndarray, " n"]:
        """Distance along each unit ray to its FIRST hit, inf where there is none within `range_m`.

        The step is the longest that cannot cross a surface of bounded slope, so that no crest is jumped over.
        """
        distance = np.full(len(ray), np.inf)
        closing = self.max_slope * np.hypot(ray[:, 0], ray[:, 1]) - ray[:, 2]
        active = np.flatnonzero(closing > 1e-4)
        dx, dy, dz = ray[active].T
        rate, t = closing[active], np.zeros(len(active))
        for _ in range(_MAX_STEPS):
            above = origin[2] + t * dz - self.height(origin[0] + t * dx, origin[1] + t * dy)
            arrived = above <= _TOLERANCE * np.maximum(t, 1.0)
            distance[active[arrived]] = t[arrived]
            go_on = ~arrived & (t < range_m)
            if not go_on.any():
                break
            active, t, above = active[go_on], t[go_on], above[go_on]
            dx, dy, dz, rate = dx[go_on], dy[go_on], dz[go_on], rate[go_on]
            t = t + above / rate
        return distance

    def stand(
        self, x: float, y: float, yaw_rad: float, wheelbase_m: float = 2.8, track_m: float = 1.6
    ) -> Float[np.ndarray, "4 4"]:
        """T_map_base of a vehicle whose rear axle is above (x, y): the plane of its four wheel contacts."""
        forward, left = np.array([np.cos(yaw_rad), np.sin(yaw_rad)]), np.array([-np.sin(yaw_rad), np.cos(yaw_rad)])
        rear = np.array([x, y])
        wheels = np.array([rear + a * forward + b * left for a in (0.0, wheelbase_m) for b in (-0.5, 0.5)])
        wheels[::2] -= 0.5 * (track_m - 1.0) * left
        wheels[1::2] += 0.5 * (track_m - 1.0) * left
        z = self.height(wheels[:, 0], wheels[:, 1])
        grade = (z[2:].mean() - z[:2].mean()) / wheelbase_m
        bank = (z[1::2].mean() - z[::2].mean()) / track_m
        ahead = np.append(forward, grade)
        ahead /= np.linalg.norm(ahead)
        up = np.cross(ahead, np.append(left, bank))
        up /= np.linalg.norm(up)
        T = np.eye(4)
        T[:3, :3] = np.stack([ahead, np.cross(up, ahead), up], axis=1)
        T[:3, 3] = x, y, z[:2].mean()
        return T


def rolling_surface(rng: np.random.Generator, grade: float = 0.015, camber: float = 0.025) -> Surface:
    """A seeded surface: grade along x, camber along y, and two long waves of some decimetres."""
    direction = rng.uniform(0.0, 2.0 * np.pi, 2)
    length_m = np.array([rng.uniform(90.0, 130.0), rng.uniform(45.0, 60.0)])
    wave = 2.0 * np.pi / length_m[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    slope = np.array([rng.uniform(-grade, grade), camber * rng.choice([-1.0, 1.0])])
    return Surface(slope, np.array([0.25, 0.06]), wave, rng.uniform(0.0, 2.0 * np.pi, 2))
