"""Pictures of calibration targets with exact truth: boards before every camera, mats on the ground (room: simulation).

In: a folder, a seed, a rig. Out: the folder that `semloc calibrate --targets` reads, and the truth beside it.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.cameras import Camera, Rig
from semloc_jax.cameras.io import write_calibration
from semloc_jax.geometry import lie
from semloc_jax.simulation.cameras import surround_rig
from semloc_jax.storage import claim, output_path, write_text, writing

_TEXEL_PX = 24
"""Pixels of the texture to a square of a target."""
_FINE = 2
"""Rays to a pixel, along each side."""
_WANDER_PX = 14.0
"""Over how many pixels the errors of the lens hang together."""
MATS = ((5.1, 1.9), (5.2, -0.4), (4.9, -2.1), (2.3, 2.2), (1.6, -2.3), (-1.9, 2.0), (-2.5, 0.3), (-2.0, -1.9))
"""Middle of each mat in the base frame [m]: each overlap has one, so that neighbours are tied to each other."""


@dataclass(frozen=True)
class TargetPlan:
    """What the targets are.

    Args:
        board: inner corners of the board along and across it.
        board_square_m: side of its squares.
        mat: inner corners of a mat.
        mat_square_m: side of its squares.
        num_views: pictures of the board for each camera.
        noise_px: error of the place of a corner in a picture, one standard deviation.
        mount_deg, mount_m: how far the mounts are off the drawing, one standard deviation.
    """

    board: tuple[int, int] = (8, 5)
    board_square_m: float = 0.1
    mat: tuple[int, int] = (5, 4)
    mat_square_m: float = 0.2
    num_views: int = 18
    noise_px: float = 0.0
    mount_deg: float = 1.0
    mount_m: float = 0.02


def simulate_targets(out: Path, seed: int = 0, plan: TargetPlan | None = None, rig: Rig | None = None) -> Rig:
    """Write boards/CAMERA/*.png, mats/CAMERA.png, targets.yaml, mats.csv, calib.yaml (drawing) and truth/calib.yaml.

    Args:
        out: the folder.
        seed: everything random follows from it.
        plan: None for the defaults.
        rig: the drawing; None for four fisheyes.

    Returns:
        The true rig.
    """
    plan, rng = plan or TargetPlan(), np.random.default_rng(seed)
    out.mkdir(parents=True, exist_ok=True)
    claim(out)
    drawing = rig or surround_rig()
    truth = _mounted_askew(drawing, plan, rng)
    write_calibration(_as_drawn(drawing), output_path(out, "calib", suffix=".yaml"))
    write_calibration(truth, output_path(out, "truth", "calib", suffix=".yaml"))
    mats = [_mat(place, plan, rng) for place in MATS]
    _write_lists(out, plan, mats)
    board, mat = _checkered(plan.board), _checkered(plan.mat)
    for index, name in enumerate(truth.names):
        camera = truth.cameras[index]
        view = _RayView.of(camera, plan.noise_px, rng)
        for number in range(plan.num_views):
            T_cam_board = _board_pose(camera, plan, number, rng)
            picture = view.picture(
                _background(camera, rng), [(board, T_cam_board, plan.board_square_m, plan.board)], rng
            )
            _write(output_path(out, "boards", name, f"{number:03d}", suffix=".png"), picture)
        T_cam_base = np.linalg.inv(np.asarray(truth.T_base_cam[index], np.float64))
        on_ground = [(mat, T_cam_base @ T, plan.mat_square_m, plan.mat) for T in mats]
        _write(output_path(out, "mats", name, suffix=".png"), view.picture(_background(camera, rng), on_ground, rng))
    return truth


@dataclass(frozen=True)
class _RayView:
    """Lines of sight of the fine pixels of a camera."""

    ray: Float[np.ndarray, "h w 3"]
    valid: Bool[np.ndarray, "h w"]
    size: tuple[int, int]

    @classmethod
    def of(cls, camera: Camera, noise_px: float, rng: np.random.Generator) -> "_RayView":
        width, height = camera.resolution
        u, v = np.meshgrid(np.arange(_FINE * width), np.arange(_FINE * height))
        uv = (np.stack([u, v], axis=-1) + 0.5) / _FINE - 0.5
        if noise_px:
            wander = rng.normal(size=(*uv.shape[:2], 2)).astype(np.float32)
            wander = cv2.GaussianBlur(wander, None, _FINE * _WANDER_PX / 2.0)
            uv += noise_px * wander / wander.std()
        ray, valid = (np.asarray(part) for part in camera.unproject(uv))
        return cls(ray, valid, (width, height))

    def picture(self, background: np.ndarray, targets: list, rng: np.random.Generator) -> np.ndarray:
        """uint8[h w]: planar targets (texture, T_cam_target, square_m, corners), sensor noise added."""
        fine = cv2.resize(background, None, fx=_FINE, fy=_FINE, interpolation=cv2.INTER_LINEAR)
        for texture, T, square_m, corners in targets:
            R, t = T[:3, :3], T[:3, 3]
            along = self.ray @ R[:, 2]
            reach = (t @ R[:, 2]) / np.where(np.abs(along) > 1e-6, along, 1e-6)
            p = (reach[..., None] * self.ray - t) @ R[:, :2] / square_m
            # The first inner corner is the origin; one square lies around the inner corners, and a white rim.
            uv = ((p + 2.0) * _TEXEL_PX - 0.5).astype(np.float32)
            inside = self.valid & (reach > 0.02)
            for axis, num in enumerate(corners):
                inside &= (p[..., axis] > -1.6) & (p[..., axis] < num + 0.6)
            shown = cv2.remap(texture, np.where(inside[..., None], uv, -1).astype(np.float32), None, cv2.INTER_LINEAR)
            fine = np.where(inside, shown, fine)
        fine = np.where(self.valid, fine, 0)
        picture = cv2.resize(fine.astype(np.float32), self.size, interpolation=cv2.INTER_AREA)
        return np.clip(picture + rng.normal(0.0, 1.5, picture.shape), 0, 255).astype(np.uint8)


def _mounted_askew(drawing: Rig, plan: TargetPlan, rng: np.random.Generator) -> Rig:
    """The cameras as they really sit."""
    sigma = np.repeat([plan.mount_m, np.deg2rad(plan.mount_deg)], 3)
    off = rng.normal(size=(len(drawing), 6)) * sigma
    return Rig(drawing.cameras, np.asarray(drawing.T_base_cam) @ np.asarray(lie.exp(off)), drawing.names)


def _as_drawn(rig: Rig) -> Rig:
    """Lenses as their data sheet says: a percent off, centred, without distortion terms."""
    cameras = []
    for camera in rig.cameras:
        width, height = camera.resolution
        focal = round(1.01 * float(camera.fx), 0)
        cameras.append(
            type(camera)(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), width, height, max_theta_rad=1.68)
        )
    return Rig(cameras, rig.T_base_cam, rig.names)


def _mat(place: tuple[float, float], plan: TargetPlan, rng: np.random.Generator) -> Float[np.ndarray, "4 4"]:
    """T_base_mat: on the ground, roughly along the vehicle, its first corner at the far left."""
    yaw = np.deg2rad(rng.normal(0.0, 6.0))
    x, y = np.array([np.sin(yaw), -np.cos(yaw)]), np.array([-np.cos(yaw), -np.sin(yaw)])
    across, along = (0.5 * plan.mat_square_m * (num - 1) for num in plan.mat)
    T = np.eye(4)
    T[:2, 0], T[:2, 1], T[2, 2] = x, y, -1.0
    T[:2, 3] = np.array(place) + rng.normal(0.0, 0.05, 2) - across * x - along * y
    return T


def _board_pose(camera: Camera, plan: TargetPlan, number: int, rng: np.random.Generator) -> Float[np.ndarray, "4 4"]:
    """A board that lies in the picture as a whole, over the views in all parts of it."""
    for _ in range(200):
        theta = np.deg2rad(rng.uniform(5.0, 68.0)) if number % 3 else np.deg2rad(rng.uniform(0.0, 30.0))
        phi = 2.0 * np.pi * (number * 0.381966 + 0.1 * rng.uniform())
        sight = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        facing = -sight
        tilt = np.deg2rad(rng.uniform(-35.0, 35.0, 3))
        right = np.cross([0.0, 1.0, 0.0], -facing)
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(-facing, right), -facing], axis=1) @ cv2.Rodrigues(tilt)[0]
        middle = plan.board_square_m * 0.5 * np.array([plan.board[0] - 1.0, plan.board[1] - 1.0, 0.0])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, rng.uniform(0.7, 1.3) * sight - R @ middle
        rim = plan.board_square_m * np.array(
            [[-1.6, -1.6, 0], [plan.board[0] + 0.6, -1.6, 0], [-1.6, plan.board[1] + 0.6, 0], [*plan.board, 0]]
        )
        p_cam = rim @ R.T + T[:3, 3]
        uv, valid = (np.asarray(a) for a in camera.project(p_cam))
        angle = np.arctan2(np.linalg.norm(p_cam[:, :2], axis=1), p_cam[:, 2])
        if (
            valid.all()
            and (angle < np.deg2rad(85.0)).all()
            and np.asarray(camera.in_image(uv[:, 0], uv[:, 1], 3.0)).all()
        ):
            return T
    raise RuntimeError("no board pose inside the picture; use a wider lens or a smaller board")


def _checkered(corners: tuple[int, int]) -> np.ndarray:
    """Texture of a chessboard with a white rim, uint8; its first inner corner is two squares from the border."""
    cols, rows = corners
    squares = (np.add.outer(np.arange(rows + 1), np.arange(cols + 1)) % 2 * 215 + 20).astype(np.uint8)
    fine = np.kron(squares, np.ones((_TEXEL_PX, _TEXEL_PX), np.uint8))
    return cv2.copyMakeBorder(fine, *(_TEXEL_PX,) * 4, cv2.BORDER_CONSTANT, value=235)


def _background(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    width, height = camera.resolution
    stains = rng.normal(size=(height // 16, width // 16)).astype(np.float32)
    return 105.0 + 12.0 * cv2.resize(stains, (width, height), interpolation=cv2.INTER_CUBIC)


def _write_lists(out: Path, plan: TargetPlan, mats: list[np.ndarray]) -> None:
    """What a person with a tape measure would write down."""
    said = "# inner corners and side of the squares\n"
    for name, (columns, rows), square_m in (
        ("board", plan.board, plan.board_square_m),
        ("mat", plan.mat, plan.mat_square_m),
    ):
        said += f"{name}: {{columns: {columns}, rows: {rows}, square_m: {square_m:g}}}\n"
    write_text(out / "targets.yaml", said)
    with writing(out / "mats.csv") as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("mat", "column", "row", "x_m", "y_m"))
        for number, T in enumerate(mats):
            for row in range(plan.mat[1]):
                for column in range(plan.mat[0]):
                    x, y = (T @ [column * plan.mat_square_m, row * plan.mat_square_m, 0.0, 1.0])[:2]
                    writer.writerow((number, column, row, f"{x:.4f}", f"{y:.4f}"))


def _write(path: Path, picture: np.ndarray) -> None:
    with writing(path) as partial:
        cv2.imwrite(str(partial), picture)
