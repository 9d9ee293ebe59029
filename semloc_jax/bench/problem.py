"""The problem that every solver of the benchmark gets: the same points, pixels, starts, prior and stopping rule.

In: a seed and a number of points. Out: Problem, as arrays, as one .npz file or as one plain binary file for C++.
1000 contour points of 3 classes, one pinhole camera of 640 x 400, cost maps on 4 levels, 6 degrees of freedom.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from semloc_jax.bench import scene
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import lie
from semloc_jax.perception.distance import signed_distance
from semloc_jax.residuals.noise import NoiseModel

RAMP_PX, STRIDE = (40.0, 14.0, 8.0, 3.0), (4, 2, 2, 1)
FULL_LEVELS, TRACKING_LEVELS = (0, 1, 3), (2, 3)
"""Levels of a solve from a wide prior and of one that follows the last frame."""
NOISE = NoiseModel(noise_px=2.0, correlation_px=60.0, ramp_share=0.15)
START_RANGE = np.array([4.0, 2.0, 0.1, np.deg2rad(0.5), np.deg2rad(0.5), np.deg2rad(5.0)])
TRACKING_RANGE = np.array([0.15, 0.05, 0.01, np.deg2rad(0.05), np.deg2rad(0.05), np.deg2rad(0.15)])
SIGMA = np.array([4.0, 2.0, 0.2, np.deg2rad(1.0), np.deg2rad(1.0), np.deg2rad(5.0)])
SUCCESS_M, SUCCESS_DEG = 0.2, 0.2
MAGIC = 0x534C4231  # "1BLS" in a little-endian file


@dataclass(frozen=True)
class Problem:
    """Arrays of one problem; poses in float64, what a solver reads at every evaluation in float32.

    Cost of a pose at one level: sum_i gain weight_i rho(ramp_i) + |y - y_prior|^2 / 2, rho Tukey's loss, y the
    tangent from the start of the level in units of `sigma`. Points outside the image at the start of a level weigh
    nothing in it. A level ends after `max_steps` evaluations or with a step below `tolerance` in every component of y.
    """

    p_map: np.ndarray
    """float32[3 p]"""
    channel: np.ndarray
    """int32[p]: class of the point."""
    weight: np.ndarray
    """float32[p]: length of contour [px] that the point stands for."""
    T_cam_base: np.ndarray
    images: tuple[np.ndarray, ...]
    """float32[class h w] of each level, coarsest first: multiples of 1/127 in [-1, 1], exact in eight bits."""
    T_true: np.ndarray
    T_prior: np.ndarray
    focal: tuple[float, float, float, float] = (scene.FX, scene.FY, scene.CX, scene.CY)
    size: tuple[int, int] = (scene.WIDTH, scene.HEIGHT)
    ramp_px: tuple[float, ...] = RAMP_PX
    stride: tuple[int, ...] = STRIDE
    max_steps: int = 10
    tolerance: float = 2e-3
    border_px: float = 2.0
    seed: int = 0

    @property
    def gains(self) -> tuple[float, ...]:
        """Nats for each unit of weight x rho, by level."""
        return tuple(NOISE.gain(ramp) for ramp in self.ramp_px)

    def starts(self, num: int, tracking: bool = False) -> np.ndarray:
        """The first `num` start poses, float64[num 4 4], drawn evenly around the truth."""
        spread = TRACKING_RANGE if tracking else START_RANGE
        draws = np.random.default_rng(self.seed + (2 if tracking else 1)).uniform(-1.0, 1.0, (num, 6))
        return self.T_true @ displacement(draws * spread)

    def errors(self, Ts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance [m] and angle [deg] of poses from the truth."""
        off = np.linalg.inv(self.T_true) @ np.asarray(Ts, np.float64)
        cosine = np.clip((np.trace(off[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1)
        # The sine keeps small angles, which the cosine of a float32 rotation has lost.
        skew = off[:, :3, :3] - np.swapaxes(off[:, :3, :3], 1, 2)
        sine = np.linalg.norm(skew[:, (2, 0, 1), (1, 2, 0)], axis=1) / 2
        return np.linalg.norm(off[:, :3, 3], axis=1), np.degrees(np.arctan2(sine, cosine))

    def succeeded(self, Ts: np.ndarray) -> np.ndarray:
        """Whether each pose is within 0.2 m and 0.2 deg of the truth."""
        distance, angle = self.errors(Ts)
        return (distance < SUCCESS_M) & (angle < SUCCESS_DEG)


def displacement(xi: np.ndarray) -> np.ndarray:
    """Rigid motions of tangents (v, omega), float64[n 4 4], with omega as a rotation vector and v as translation."""
    T = np.broadcast_to(np.eye(4), (len(xi), 4, 4)).copy()
    T[:, :3, :3], T[:, :3, 3] = rotation(xi[:, 3:]), xi[:, :3]
    return T


def rotation(omega: np.ndarray) -> np.ndarray:
    """Rotation matrices of rotation vectors [rad], float64[n 3 3]."""
    angle = np.maximum(np.linalg.norm(omega, axis=1), 1e-12)[:, None, None]
    W = np.zeros((len(omega), 3, 3))
    W[:, (2, 0, 1), (1, 2, 0)], W[:, (1, 2, 0), (2, 0, 1)] = omega, -omega
    W /= angle
    return np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W


def make_problem(num_points: int = 1000, seed: int = 0) -> Problem:
    """The problem with so many points; the street, the images and the starts depend on the seed only."""
    elements, T_true = scene.street(seed), scene.true_pose()
    T_cam_base = np.asarray(lie.inverse(scene.camera_mount()), np.float64)
    T_cam_map = T_cam_base @ np.linalg.inv(T_true)
    p_map, channel, length_px = scene.contour_points(elements, T_cam_map, num_points)
    layers = scene.masks(elements, T_cam_map)
    distance = np.stack([signed_distance(layer, 1.0) for layer in layers])
    images = tuple(_level(distance, ramp, stride) for ramp, stride in zip(RAMP_PX, STRIDE, strict=True))
    off = np.array([[0.8, -0.4, 0.02, 0.001, 0.001, 0.01]])
    return Problem(
        p_map=np.ascontiguousarray(p_map.T, np.float32),
        channel=channel.astype(np.int32),
        weight=np.full(num_points, length_px, np.float32),
        T_cam_base=T_cam_base,
        images=images,
        T_true=T_true,
        T_prior=T_true @ displacement(off)[0],
        seed=seed,
    )


def _level(distance: np.ndarray, ramp_px: float, stride: int) -> np.ndarray:
    """The ramp of one level, rounded to what eight bits hold, so that every solver reads the same values."""
    size = distance.shape[2] // stride, distance.shape[1] // stride
    reduced = np.stack([cv2.resize(plane, size, interpolation=cv2.INTER_AREA) for plane in distance])
    return (np.round(np.clip(reduced / ramp_px, -1, 1) * 127) / 127).astype(np.float32)


_ARRAYS = ("p_map", "channel", "weight", "T_cam_base", "T_true", "T_prior")
_NUMBERS = ("max_steps", "tolerance", "border_px", "seed")


def write_problem(problem: Problem, path: Path) -> None:
    """Write the problem as .npz, and beside it as .bin for programs that read plain binary."""
    arrays = {name: getattr(problem, name) for name in (*_ARRAYS, *_NUMBERS)}
    np.savez(path, **arrays, **{f"level{k}": image for k, image in enumerate(problem.images)})
    path.with_suffix(".bin").write_bytes(to_binary(problem))


def read_problem(path: Path) -> Problem:
    """The problem of an .npz file.

    Raises:
        SemlocError: The file is missing.
    """
    if not path.is_file():
        raise SemlocError(f"benchmark problem {path}: no such file; expected one that `semloc bench` has written")
    with np.load(path) as file:
        images = tuple(file[f"level{k}"] for k in range(len(STRIDE)))
        numbers = {name: file[name].item() for name in _NUMBERS}
        return Problem(images=images, **{name: file[name] for name in _ARRAYS}, **numbers)


def to_binary(problem: Problem) -> bytes:
    """The problem as little-endian integers, doubles and floats, in the order that tests/ceres/problem.h reads.

    int32: magic, points, classes, levels, max_steps, width, height, 0; by level: stride, height, width, 0.
    float64: fx fy cx cy, tolerance, border, sigma[6], T_cam_base[16], T_true[16], T_prior[16]; by level: gain.
    float32: p_map[3 p], weight[p]; int32: channel[p]; float32: the images.
    """
    (width, height), num_points = problem.size, problem.p_map.shape[1]
    header = [MAGIC, num_points, len(scene.CLASSES), len(problem.images), problem.max_steps, width, height, 0]
    for image, stride in zip(problem.images, problem.stride, strict=True):
        header += [stride, image.shape[1], image.shape[2], 0]
    doubles = [*problem.focal, problem.tolerance, problem.border_px, *SIGMA]
    poses = [T.ravel() for T in (problem.T_cam_base, problem.T_true, problem.T_prior)]
    parts = [
        np.asarray(header, "<i4"),
        np.concatenate([doubles, *poses, problem.gains]).astype("<f8"),
        problem.p_map.astype("<f4"),
        problem.weight.astype("<f4"),
        problem.channel.astype("<i4"),
        *(image.astype("<f4") for image in problem.images),
    ]
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
