"""A vehicle in a street of points, with noisy rays and a noisy inertial sensor: truth for inertial windows."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline

from semloc_jax.cameras import PinholeCamera
from semloc_jax.datasets import Imu
from semloc_jax.fusion.inertial_moment import InertialMoment, InertialWindowConfig
from semloc_jax.fusion.inertial_samples import steps_between
from semloc_jax.fusion.inertial_states import SIZES
from semloc_jax.geometry import rigid
from semloc_jax.perception.sight_lines import sight_lines
from semloc_jax.perception.tracks import Tracks
from semloc_jax.structs import InertialNoise

CAMERA = PinholeCamera(500.0, 500.0, 399.5, 299.5, 800.0, 600.0)
AHEAD = np.array([[0.0, 0.0, 1.0, 1.5], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.4], [0.0, 0.0, 0.0, 1.0]])
FRAME_S = 0.1
USUAL = InertialNoise()


@dataclass(frozen=True)
class World:
    """Noise of the sensors; the motion is the same but for its seed."""

    seed: int = 0
    num_slots: int = 60
    step_px: float = InertialWindowConfig.step_px
    """What a track slips from one image to the next."""
    sensor: InertialNoise = USUAL
    noise: float = 1.0
    """0: perfect sensors without biases."""
    has_road: bool = False
    """Whether some points are known to lie on the road."""
    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Turn of the inertial sensor against the base."""
    delay_s: float = 0.0
    """Its clock less that of the cameras."""
    rate_hz: float = 100.0
    speed_mps: float = 9.0

    def pose(self, t):
        """A closed form with turns, braking and suspension; poses of any number of times."""
        t = np.asarray(t, float)
        phase = 0.7 * self.seed
        T = np.tile(np.eye(4), (*t.shape, 1, 1))
        yaw = 0.25 * np.sin(0.5 * t + phase)
        z, zero = 0.03 * np.sin(7.0 * t + phase), np.zeros_like(t)
        angles = np.stack([0.008 * np.sin(5.0 * t), 0.01 * np.sin(6.0 * t + phase), zero], axis=-1)
        T[..., :3, :3] = (
            rigid.exp(np.concatenate([np.zeros((*t.shape, 5)), yaw[..., None]], -1))[..., :3, :3]
            @ rigid.exp(np.concatenate([np.zeros_like(angles), angles], -1))[..., :3, :3]
        )
        T[..., :2, 3], T[..., 2, 3] = _way(self.speed_mps, phase)(t), z
        return T

    def velocity(self, t, h=1e-4):
        """Of the base in the map."""
        return (self.pose(np.asarray(t) + h)[..., :3, 3] - self.pose(np.asarray(t) - h)[..., :3, 3]) / (2 * h)

    def imu(self, end_s, rng):
        """Rates and forces with noise and the true biases over time."""
        t = np.arange(-0.05, end_s + 0.06, 1.0 / self.rate_hz)
        h = 1e-3
        before, here, after = self.pose(t - h), self.pose(t), self.pose(t + h)
        gyro = rigid.log(rigid.inverse(before) @ after)[:, 3:] / (2 * h)
        accel = (before[:, :3, 3] - 2 * here[:, :3, 3] + after[:, :3, 3]) / h**2 + [0, 0, 9.81]
        accel = np.einsum("nji,nj->ni", here[:, :3, :3], accel)
        sigma = np.repeat([self.sensor.gyro_density, self.sensor.accel_density], 3) * np.sqrt(self.rate_hz)
        walk = np.array(self.sensor.bias_walk) / np.sqrt(self.rate_hz)
        bias = rng.normal(size=6) * np.repeat([0.002, 0.05], 3) + np.cumsum(walk * rng.normal(size=(len(t), 6)), axis=0)
        R = rigid.exp(np.concatenate([np.zeros(3), np.deg2rad(self.mount_deg)]))[:3, :3]
        in_sensor = np.column_stack([gyro @ R, accel @ R])
        noisy = in_sensor + self.noise * (sigma * rng.normal(size=(len(t), 6)) + bias)
        return Imu(t + self.delay_s, noisy[:, :3], noisy[:, 3:], self.sensor), self.noise * bias

    def moments(self, num, T_base_cam=None):
        """So many image times, the true states there {pose, velocity, bias, scale}."""
        rng = np.random.default_rng(self.seed)
        T_base_cam = np.stack([AHEAD]) if T_base_cam is None else T_base_cam
        time_s = FRAME_S * np.arange(num)
        Ts = self.pose(time_s)
        imu, bias = self.imu(time_s[-1], rng)
        capacity = int(self.rate_hz * FRAME_S) + 6
        points = _street(self.speed_mps * time_s[-1] + 80.0, rng)
        on_road = self.has_road & (np.arange(len(points)) % 6 == 0)
        points[on_road, 1] *= 0.3
        points[on_road, 2] = 0.02 * self.noise * rng.normal(size=on_road.sum())
        slipped = np.zeros((self.num_slots, 2))
        moments, held, number = [], np.full(self.num_slots, -1), np.full(self.num_slots, -1)
        next_id = 0
        for k, t in enumerate(time_s):
            p_cam = (points - Ts[k, :3, 3]) @ Ts[k, :3, :3]
            p_cam = (p_cam - T_base_cam[0, :3, 3]) @ T_base_cam[0, :3, :3]
            seen = (p_cam[:, 2] > 3.0) & (p_cam[:, 2] < 60.0)
            uv = p_cam[:, :2] / np.where(seen, p_cam[:, 2], 1.0)[:, None] * 500.0 + [399.5, 299.5]
            seen &= (uv > 0).all(axis=1) & (uv < [799, 599]).all(axis=1)
            # A track ends when its point leaves the view, and now and then before.
            lost = (held >= 0) & (~seen[held] | (rng.random(self.num_slots) < 0.08))
            held[lost], number[lost] = -1, -1
            free, new = np.flatnonzero(held < 0), rng.permutation(np.setdiff1d(np.flatnonzero(seen), held))
            free = free[: len(new)]
            held[free], number[free] = new[: len(free)], next_id + np.arange(len(free))
            next_id += len(free)
            slipped += self.noise * self.step_px * rng.normal(size=slipped.shape)
            slipped[free] = 0.0
            noisy = np.where(held[:, None] >= 0, uv[held], 300.0) + slipped
            sight = sight_lines(CAMERA, noisy)
            tracks = Tracks(number.copy(), np.zeros(self.num_slots, int), noisy, sight, 0, 5.0, on_road[held])
            steps = None if k == 0 else steps_between(imu, float(time_s[k - 1]), float(t), capacity)
            moments.append(InertialMoment(float(t), tracks, T_base_cam, steps))
        biases = np.stack([np.interp(time_s, imu.time_s, column) for column in bias.T], axis=1)
        truth = {
            "pose": Ts,
            "height": np.zeros((num, 1)),
            "bend": np.zeros((num, 1)),
            "velocity": self.velocity(time_s),
            "bias": biases,
            "scale": np.ones((num, 1)),
            "mount": np.tile(np.deg2rad(self.mount_deg), (num, 1)),
            "delay": np.full((num, 1), self.delay_s),
        }
        return moments, truth


@cache
def _way(speed_mps, phase):
    """Positions in the plane of a rear axle that goes where it points: the integral of speed along heading."""
    t = np.arange(-1.0, 40.0, 0.005)
    yaw, speed = 0.25 * np.sin(0.5 * t + phase), speed_mps + 0.72 * np.cos(0.9 * t + phase)
    return CubicSpline(t, speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])).antiderivative()


def _street(length_m, rng):
    """Points on fronts, trees and the ground of a street along x."""
    num = int(6 * length_m)
    x, side = rng.uniform(0, length_m, num), rng.choice([-1.0, 1.0], num)
    y = side * rng.uniform(4.0, 14.0, num)
    return np.column_stack([x, y + 6.0 * np.sin(0.05 * x), rng.uniform(0.0, 8.0, num)])


def near(truth, num, scale, seed):
    """Guesses of the first states, off by `scale` times (5 cm, 0.3 deg, 0.1 m/s, small biases)."""
    rng = np.random.default_rng(seed + 1000)
    sigma = np.array([0.05] * 3 + [0.005] * 3) * scale
    values = {name: truth[name][:num].copy() for name in SIZES}
    values["pose"] = values["pose"] @ rigid.exp(rng.normal(size=(num, 6)) * sigma)
    values["velocity"] += 0.1 * scale * rng.normal(size=(num, 3))
    values["bias"] = values["bias"] + scale * np.repeat([1e-3, 2e-2], 3) * rng.normal(size=(num, 6))
    return values
