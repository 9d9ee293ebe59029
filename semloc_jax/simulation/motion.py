"""How the simulated vehicle moves: pose at any time (room: simulation; host).

In: path, ground, speed. Out: T_map_base(t).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from semloc_jax.simulation.path import PlanePath
from semloc_jax.simulation.surface import Surface


class TrueMotion(ABC):
    """Where the vehicle is at any time."""

    @abstractmethod
    def poses(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        """T_map_base at times [s]; time 0 is that of the first frame."""

    def pose(self, time_s: float) -> Float[np.ndarray, "4 4"]:
        """T_map_base at a time [s]."""
        return self.poses(np.array([time_s]))[0]


@dataclass(frozen=True)
class VehicleMotion(TrueMotion):
    """A drive along a path with gently changing speed; the body pitches and rolls a little on its springs.

    Args:
        path: line of the rear axle.
        surface: ground.
        speed_mps: mean speed.
        sway_m: amplitude of the lateral wander about the path.
        tilt_deg: amplitude of pitch and roll on the springs.
        phase_rad: seeded phases of speed, wander, pitch and roll.
    """

    path: PlanePath
    surface: Surface
    speed_mps: float
    sway_m: float
    tilt_deg: float
    phase_rad: Float[np.ndarray, "4"]

    def travelled_m(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Arc length of the path at times: the speed swings by 10 % over 6 s."""
        wave = 2.0 * np.pi / 6.0
        swing = (np.sin(wave * time_s + self.phase_rad[0]) - np.sin(self.phase_rad[0])) * 0.1 / wave
        return self.speed_mps * (time_s + swing)

    def poses(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        s = self.travelled_m(time_s)
        wave = 2.0 * np.pi / 45.0
        lateral = self.sway_m * np.sin(wave * s + self.phase_rad[1])
        turned = np.arctan(self.sway_m * wave * np.cos(wave * s + self.phase_rad[1]))
        T = self.surface.stand(self.path.at(s, lateral), self.path.heading_at(s) + turned)
        pitch = self.tilt_deg * np.sin(2.0 * np.pi * 1.3 * time_s + self.phase_rad[2])
        roll = self.tilt_deg * np.sin(2.0 * np.pi * 0.9 * time_s + self.phase_rad[3])
        tilt = Rotation.from_euler("yx", np.column_stack([pitch, roll]), degrees=True).as_matrix()
        T[:, :3, :3] = T[:, :3, :3] @ tilt
        return T
