"""Gauss-Newton on images in the manner of PixLoc, in torch (room: bench; own code from the published idea).

In: a Problem. Out: poses. Per step: project, interpolate value and gradient, weigh robustly, chain the Jacobian of
every point, sum to a damped 6x6 system, solve by Cholesky, move. Steps are always taken, as PixLoc does.
"""

import numpy as np

from semloc_jax.bench.peer import Solved
from semloc_jax.bench.problem import SIGMA, Problem

DAMPING = 1e-4
"""Added to the diagonal as a share of it; PixLoc learns this number for every direction."""


def create(_: str) -> "PixlocPeer":
    """The torch program, one thread."""
    return PixlocPeer()


class PixlocPeer:
    """One start after another, as PixLoc refines one query."""

    def __init__(self) -> None:
        import torch

        self.torch = torch
        torch.set_num_threads(1)

    def load(self, problem: Problem) -> None:
        """The arrays as float32 tensors."""
        torch, self.problem = self.torch, problem
        self.points = torch.tensor(problem.p_map.T.copy())
        self.channel = torch.tensor(problem.channel).long()
        self.weight = torch.tensor(problem.weight)
        self.images = [torch.tensor(image) for image in problem.images]
        self.T_cam_base, self.T_prior = (torch.tensor(T).float() for T in (problem.T_cam_base, problem.T_prior))
        self.focal, self.center = torch.tensor(problem.focal[:2]), torch.tensor(problem.focal[2:])
        self.sigma = torch.tensor(SIGMA).float()

    def solve(self, Ts_init: np.ndarray, levels: tuple[int, ...]) -> Solved:
        """All starts through all levels."""
        poses, total = [], 0
        with self.torch.no_grad():
            for T_init in Ts_init:
                T = self.torch.tensor(T_init).float()
                for level in levels:
                    T, num_steps = self._solve_level(T, level)
                    total += num_steps
                poses.append(T.numpy())
        return Solved(np.stack(poses), total / len(poses))

    def _solve_level(self, T, level: int):
        torch, problem = self.torch, self.problem
        _, _, uv, in_front = self._project(T)
        low, size = problem.border_px - 0.5, torch.tensor(problem.size)
        seen = in_front & (uv >= low).all(-1) & (uv <= size - 1 - low).all(-1)
        weight = problem.gains[level] * self.weight * seen
        for num_steps in range(1, problem.max_steps + 1):
            y = self._step(T, level, weight)
            T = T @ self._exp(y * self.sigma)
            if y.abs().max() < problem.tolerance:
                return T, num_steps
        return T, problem.max_steps

    def _step(self, T, level: int, weight):
        """The damped Gauss-Newton step in the right tangent of T, in units of the prior."""
        torch = self.torch
        p_base, p_cam, uv, _ = self._project(T)
        value, J_image = self._interpolate(level, uv)
        robust = weight * (1 - value * value).clamp(min=0) ** 2
        depth = p_cam[:, 2].clamp(min=1e-2)
        J_pixel = torch.zeros(len(p_cam), 2, 3)
        J_pixel[:, 0, 0], J_pixel[:, 1, 1] = self.focal[0] / depth, self.focal[1] / depth
        J_pixel[:, :, 2] = -self.focal * p_cam[:, :2] / depth[:, None] ** 2
        J_point = torch.cat([-torch.eye(3).expand(len(p_base), 3, 3), self._skew(p_base)], -1)
        J = (J_image[:, None] @ J_pixel @ (self.T_cam_base[:3, :3] @ J_point))[:, 0] * self.sigma
        off = self._log(torch.linalg.inv(T) @ self.T_prior) / self.sigma
        gradient = torch.einsum("ni,n,n->i", J, robust, value) - off
        hessian = torch.einsum("ni,n,nj->ij", J, robust, J) + torch.eye(6)
        damped = hessian + DAMPING * torch.diag(hessian.diagonal())
        return -torch.cholesky_solve(gradient[:, None], torch.linalg.cholesky(damped))[:, 0]

    def _project(self, T):
        R, t = T[:3, :3], T[:3, 3]
        p_base = (self.points - t) @ R
        p_cam = p_base @ self.T_cam_base[:3, :3].T + self.T_cam_base[:3, 3]
        uv = self.focal * p_cam[:, :2] / p_cam[:, 2:].clamp(min=1e-2) + self.center
        return p_base, p_cam, uv, p_cam[:, 2] > 1e-2

    def _interpolate(self, level: int, uv):
        torch, stride, image = self.torch, self.problem.stride[level], self.images[level]
        _, height, width = image.shape
        xy = (uv + 0.5) / stride - 0.5
        held = torch.stack([xy[:, 0].clamp(0, width - 1.001), xy[:, 1].clamp(0, height - 1.001)], -1)
        j, i = held.long().unbind(-1)
        fu, fv = (held - torch.stack([j, i], -1)).unbind(-1)
        at = (self.channel * height + i) * width + j
        a, b, c, d = (image.view(-1)[at + step] for step in (0, 1, width, width + 1))
        top, bottom = a + fu * (b - a), c + fu * (d - c)
        gradient = torch.stack([(b - a) + fv * ((d - c) - (b - a)), bottom - top], -1) / stride
        return top + fv * (bottom - top), gradient * (held == xy)

    def _skew(self, p):
        zero = self.torch.zeros_like(p[..., 0])
        rows = [zero, -p[..., 2], p[..., 1], p[..., 2], zero, -p[..., 0], -p[..., 1], p[..., 0], zero]
        return self.torch.stack(rows, -1).reshape(*p.shape[:-1], 3, 3)

    def _exp(self, xi):
        T = self.torch.eye(4)
        T[:3, :3], T[:3, 3] = self.torch.linalg.matrix_exp(self._skew(xi[3:])), xi[:3]
        return T

    def _log(self, T):
        """(v, omega) for small rotations, to the second order."""
        turn = (T[:3, :3] - T[:3, :3].T) / 2
        return self.torch.cat([T[:3, 3], self.torch.stack([turn[2, 1], turn[0, 2], turn[1, 0]])])
