"""The cost of the problem in plain numpy, with its derivative by hand (room: bench; host).

In: a Problem, a level and the pose at its start. Out: residuals and Jacobian by the scaled tangent y.
It shares nothing with the package's residual but the definition: peers that want numpy arrays use it, and tests hold
the two against each other. Chart: T_local_base = T_start [Exp(w) | v], (v, w) = sigma y.
"""

from collections.abc import Callable

import numpy as np

from semloc_jax.bench.peer import Solved
from semloc_jax.bench.problem import SIGMA, Problem, displacement, rotation


class LevelModel:
    """One level of the problem: visibility frozen at the start pose, as every peer has it."""

    def __init__(self, problem: Problem, level: int, T_start: np.ndarray) -> None:
        self.problem, self.T_start = problem, T_start
        self.image, self.stride = problem.images[level], problem.stride[level]
        T = np.linalg.inv(T_start)
        self.p_start = T[:3, :3] @ problem.p_map + T[:3, 3:]
        u, v, in_front = self._pixels(self._in_camera(self.p_start)[1])
        (width, height), low = problem.size, problem.border_px - 0.5
        seen = in_front & (u >= low) & (v >= low) & (u <= width - 1 - low) & (v <= height - 1 - low)
        self.root = np.sqrt(problem.gains[level] * problem.weight * seen)
        self.y_prior = tangent(T @ problem.T_prior) / SIGMA

    def pose(self, y: np.ndarray) -> np.ndarray:
        """T_local_base at y."""
        return self.T_start @ displacement((SIGMA * y)[None])[0]

    def residual(self, y: np.ndarray) -> np.ndarray:
        """Residuals of points and prior; half their squared norm is the cost."""
        _, p_cam = self._in_camera(self._in_base(y))
        value, _, _ = self._lookup(*self._pixels(p_cam)[:2])
        return np.concatenate([self.root * value * _root(value), y - self.y_prior])

    def residual_and_jacobian(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and their derivative by y, [n+6] and [n+6 6]."""
        p_base, (x, y_cam, z) = self._in_camera(self._in_base(y))
        value, du, dv = self._lookup(*self._pixels((x, y_cam, z))[:2])
        fx, fy, _, _ = self.problem.focal
        depth = np.maximum(z, 1e-2)
        root = _root(value)
        # d/dv of v root(v) is rho'(v) over the residual, or 1 at zero.
        slope = self.root * np.maximum(1 - value * value, 0) ** 2 / root
        a_cam = np.stack([slope * du * fx, slope * dv * fy, -slope * (du * fx * x + dv * fy * y_cam) / depth]) / depth
        a = self.problem.T_cam_base[:3, :3].T @ a_cam
        omega = (SIGMA * y)[3:]
        by_v = -rotation(omega[None])[0] @ a
        by_w = right_jacobian(omega).T @ np.cross(a, p_base, axis=0)
        jacobian = np.concatenate([np.concatenate([by_v, by_w]).T * SIGMA, np.eye(6)])
        return np.concatenate([self.root * value * root, y - self.y_prior]), jacobian

    def _in_base(self, y: np.ndarray) -> np.ndarray:
        xi = SIGMA * y
        return rotation(xi[None, 3:])[0].T @ (self.p_start - xi[:3, None])

    def _in_camera(self, p_base: np.ndarray) -> tuple[np.ndarray, tuple]:
        T = self.problem.T_cam_base
        return p_base, tuple(T[:3, :3] @ p_base + T[:3, 3:])

    def _pixels(self, p_cam: tuple) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x, y, z = p_cam
        fx, fy, cx, cy = self.problem.focal
        depth = np.maximum(z, 1e-2)
        return fx * x / depth + cx, fy * y / depth + cy, z > 1e-2

    def _lookup(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bilinear value and its gradient by u and v."""
        channel, (_, height, width) = self.problem.channel, self.image.shape
        x, y = (u + 0.5) / self.stride - 0.5, (v + 0.5) / self.stride - 0.5
        held_x, held_y = np.clip(x, 0, width - 1.001), np.clip(y, 0, height - 1.001)
        j, i = held_x.astype(np.int64), held_y.astype(np.int64)
        fu, fv = held_x - j, held_y - i
        a, b = self.image[channel, i, j], self.image[channel, i, j + 1]
        c, d = self.image[channel, i + 1, j], self.image[channel, i + 1, j + 1]
        top, bottom = a + fu * (b - a), c + fu * (d - c)
        du = ((b - a) + fv * ((d - c) - (b - a))) / self.stride * (held_x == x)
        dv = (bottom - top) / self.stride * (held_y == y)
        return top + fv * (bottom - top), du, dv


def _root(value: np.ndarray) -> np.ndarray:
    """sqrt(2 rho(v)) / |v| of Tukey's loss."""
    s = np.minimum(value * value, 1)
    return np.sqrt((3 - 3 * s + s * s) / 3)


def tangent(T: np.ndarray) -> np.ndarray:
    """(v, omega) of a rigid motion [Exp(omega) | v]."""
    skew = T[:3, :3] - T[:3, :3].T
    axis = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / 2
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, (np.trace(T[:3, :3]) - 1) / 2)
    return np.concatenate([T[:3, 3], axis * (angle / sine if sine > 1e-9 else 1.0)])


def right_jacobian(omega: np.ndarray) -> np.ndarray:
    """J_r with Exp(omega + d) = Exp(omega) Exp(J_r d)."""
    angle = max(np.linalg.norm(omega), 1e-6)
    W = np.cross(np.eye(3), omega / angle)
    return np.eye(3) - (1 - np.cos(angle)) / angle * W + (1 - np.sin(angle) / angle) * W @ W


def coarse_to_fine(
    Ts_init: np.ndarray, levels: tuple[int, ...], solve_level: Callable[[np.ndarray, int], tuple[np.ndarray, int]]
) -> Solved:
    """Every start through all levels, one after another.

    Args:
        Ts_init: Start poses.
        levels: Levels, coarsest first.
        solve_level: Pose and number of evaluations from a pose and a level.
    """
    Ts, total = [], 0
    for T in Ts_init:
        for level in levels:
            T, evaluations = solve_level(T, level)
            total += evaluations
        Ts.append(T)
    return Solved(np.stack(Ts), total / len(Ts))
