"""How the simulated vehicle moves: pose at any time (room: simulation; host).

In: path, ground, speed, where to stop. Out: T_map_base(t), also of a way with stops, slow bends and backing up.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d, minimum_filter1d
from scipy.spatial.transform import Rotation

from semloc_jax.geometry.polyline import arc_length
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


_STEP_M, _STEP_S = 0.1, 0.02
_JERK_S = 0.25
"""Speed changes over about this time: no driver brakes from one moment to the next."""
_WAVE_M = np.array([3.1, 7.3])
"""Pitch and roll on the springs come from the ground, so that a standing vehicle does not sway."""


@dataclass(frozen=True)
class DrivingStyle:
    """How somebody drives.

    Args:
        speed_mps: on the straight.
        sideways_mps2: acceleration in bends, at most.
        braking_mps2: deceleration towards stops and bends, and acceleration after them.
    """

    speed_mps: float
    sideways_mps2: float = 1.8
    braking_mps2: float = 1.5


@dataclass(frozen=True)
class RouteMotion(TrueMotion):
    """A vehicle on a way by a time table.

    Args:
        path: line of the rear axle; its heading is that of the vehicle, also where it backs up.
        surface: ground.
        time_s: times of the table, evenly spaced; time 0 is that of the first frame.
        s_m: arc length at these times, never falling.
        tilt_deg: amplitude of pitch and roll on the springs.
        phase_rad: of pitch and roll.
    """

    path: PlanePath
    surface: Surface
    time_s: Float[np.ndarray, " n"]
    s_m: Float[np.ndarray, " n"]
    tilt_deg: float
    phase_rad: Float[np.ndarray, "2"]

    def travelled_m(self, time_s: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Arc length at times [s]."""
        return np.interp(time_s, self.time_s, self.s_m)

    def poses(self, time_s: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 4 4"]:
        s = self.travelled_m(time_s)
        T = self.surface.stand(self.path.at(s), self.path.heading_at(s))
        angle_deg = self.tilt_deg * np.sin(2.0 * np.pi * s[:, None] / _WAVE_M + self.phase_rad)
        tilt = Rotation.from_euler("yx", angle_deg, degrees=True).as_matrix()
        T[:, :3, :3] = T[:, :3, :3] @ tilt
        return T


def timed(
    path: PlanePath,
    surface: Surface,
    style: DrivingStyle,
    stops: Sequence[tuple[float, float]],
    span_m: tuple[float, float],
    start_m: float,
    rng: np.random.Generator,
    limits: Sequence[tuple[float, float, float]] = (),
) -> RouteMotion:
    """Drive a way from one place to another.

    Args:
        path: line of the rear axle.
        surface: ground.
        style: how to drive.
        stops: arc length [m] and duration [s] of each stop.
        span_m: where the time table begins and ends.
        start_m: where the vehicle is at time 0.
        rng: phases of pitch and roll.
        limits: from where to where [m] how fast at most [m/s].
    """
    s = np.arange(span_m[0], span_m[1], _STEP_M)
    bend = np.abs(np.gradient(path.heading_at(s), _STEP_M))
    bend = gaussian_filter1d(bend, 0.5 / _STEP_M, mode="nearest")
    fastest = np.minimum(style.speed_mps, np.sqrt(style.sideways_mps2 / np.maximum(bend, 1e-6)))
    fastest = minimum_filter1d(fastest, 11, mode="nearest")
    for begin, end, most in limits:
        fastest = np.where((s >= begin) & (s <= end), np.minimum(fastest, most), fastest)
    at_stop = [int(np.clip(round((where - span_m[0]) / _STEP_M), 0, len(s) - 1)) for where, _ in stops]
    fastest[at_stop] = 0.0
    speed = _braked(_braked(fastest, style.braking_mps2)[::-1], style.braking_mps2)[::-1]
    took_s = _STEP_M / np.maximum(0.5 * (speed[1:] + speed[:-1]), 1e-3)
    arrival = np.concatenate([[0.0], np.cumsum(took_s)])
    # A stop is a step in the time of arrival: the place is held from then on.
    held_s = np.zeros(len(s))
    for index, (_, duration_s) in zip(at_stop, stops, strict=True):
        held_s[index] += duration_s
    leaving = arrival + np.cumsum(held_s)
    table_t = np.column_stack([leaving - held_s, leaving]).ravel()
    table_s = np.repeat(s, 2)
    distinct = np.concatenate([[True], np.diff(table_t) > 1e-9])
    time_s = np.arange(0.0, table_t[-1], _STEP_S)
    s_of_t = gaussian_filter1d(
        np.interp(time_s, table_t[distinct], table_s[distinct]), _JERK_S / _STEP_S, mode="nearest"
    )
    start_s = float(np.interp(start_m, s_of_t, time_s))
    return RouteMotion(path, surface, time_s - start_s, s_of_t, 0.12, rng.uniform(0.0, 2.0 * np.pi, 2))


def on_table(s_m: Float[np.ndarray, " k"], first_m: float) -> Float[np.ndarray, " k"]:
    """Arc lengths that the time table of a way from `first_m` on holds: the place of a stop is one of them."""
    return first_m + np.round((s_m - first_m) / _STEP_M) * _STEP_M


def _braked(fastest: np.ndarray, braking_mps2: float) -> np.ndarray:
    """Speeds from the left that rise no faster than the acceleration allows."""
    squared, rise = fastest**2, 2.0 * braking_mps2 * _STEP_M
    # v_k^2 <= v_j^2 + rise (k - j) for all j before k: a running minimum.
    index = rise * np.arange(len(squared))
    return np.sqrt(np.maximum(np.minimum.accumulate(squared - index) + index, 0.0))


def driven_line(xy: Float[np.ndarray, "n 2"]) -> PlanePath:
    """A path through places about 0.1 m apart; the heading is that of the motion."""
    dx, dy = np.gradient(xy, axis=0).T
    return PlanePath(arc_length(xy), xy, np.unwrap(np.arctan2(dy, dx)))
