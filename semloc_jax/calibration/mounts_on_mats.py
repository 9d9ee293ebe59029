"""Mounts of cameras from surveyed corners on the ground (room: calibration; host).

In: calibrated lenses, mounts by drawing, corners of mats in pixels and metres. Out: MountFit: the rig, how far off
surveyed corners are, and how far those of mats that were held out.
The survey is one more camera of the ground problem, straight above the vehicle and locked: the same solver serves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from semloc_jax.calibration.ground_problem import GroundPointProblem, GroundState, solve_ground_points
from semloc_jax.cameras import Camera, PinholeCamera, Rig
from semloc_jax.cameras.bev import T_base_bev
from semloc_jax.errors import SemlocError

_ABOVE_M, _ABOVE_PX = 20.0, 1000.0
_CORNER_PX = 0.2
"""What a corner in a picture is known to; it makes far corners count less. Ours."""
_SMOOTH_M, _NOISE_M = 0.004, 0.002
_FEWEST = 12
_MOST_FOLDS = 8


@dataclass(frozen=True)
class MatCorners:
    """Corners of one mat in one camera: pixels and surveyed places, float64[n 2] each."""

    camera: int
    mat: str
    uv: Float[np.ndarray, "n 2"]
    p_base: Float[np.ndarray, "n 2"]


@dataclass(frozen=True)
class MountFit:
    """Mounts found from mats.

    Attributes:
        rig: the corrected cameras.
        before_m, after_m: distance of each corner to where it was surveyed, in the order of the corners.
        held_out_m: the same with a rig that was made without its mat; nan where a camera would see none.
        camera, p_base: of each corner.
    """

    rig: Rig
    before_m: np.ndarray
    after_m: np.ndarray
    held_out_m: np.ndarray
    camera: np.ndarray
    p_base: np.ndarray


_DRAWN_M, _DRAWN_DEG = 0.1, 3.0
"""How far a drawing may be off."""


def fit_mounts(rig: Rig, seen: Sequence[MatCorners]) -> MountFit:
    """Mounts under which each camera sees the corners where they were surveyed.

    Args:
        rig: calibrated lenses, mounts by drawing.
        seen: what each camera sees of each mat.

    Raises:
        SemlocError: a camera sees too few corners.
    """
    camera = np.concatenate([np.full(len(s.uv), s.camera) for s in seen] or [np.zeros(0, int)])
    for index, name in enumerate(rig.names):
        if (camera == index).sum() < _FEWEST:
            raise SemlocError(
                f"camera {name}: {(camera == index).sum()} surveyed corners on the ground; expected {_FEWEST} and more "
                "(one whole mat, better two apart); check mats.csv, the mounts in calib.yaml and mats/"
                f"{name}.png"
            )
    uv, p_base = (np.concatenate([getattr(s, part) for s in seen]) for part in ("uv", "p_base"))
    names = list(dict.fromkeys(s.mat for s in seen))
    mat = np.concatenate([np.full(len(s.uv), names.index(s.mat)) for s in seen])
    num = len(rig)
    above, T_above = _survey_camera()
    uv_above = -_ABOVE_PX / _ABOVE_M * p_base[:, ::-1]
    sigma = np.tile([_DRAWN_M] * 3 + [np.deg2rad(_DRAWN_DEG)] * 3, num + 1)
    sigma[6 * num :] = 0.0
    with jax.enable_x64(True):
        T_prior = jnp.asarray(np.concatenate([np.asarray(rig.T_base_cam, np.float64), T_above[None]]))
        problem = GroundPointProblem(
            (*rig.cameras, above),
            jnp.asarray(np.stack([camera, np.full(len(camera), num)], axis=1)),
            jnp.asarray(np.stack([uv, uv_above], axis=1)),
            jnp.ones(len(camera)),
            T_prior,
            jnp.asarray(sigma),
            _NOISE_M,
            _SMOOTH_M,
            ((),) * (num + 1),
        )
        start = GroundState(T_prior, jnp.zeros((num + 1, 0)))
        before = np.linalg.norm(np.asarray(problem.distances(start)), axis=1)
        weight = _weights(rig, camera, uv)
        mats = np.unique(mat)[:_MOST_FOLDS] if len(np.unique(mat)) > 1 else np.zeros(0, int)
        folds = np.stack([weight, *(np.where(mat == k, 0.0, weight) for k in mats)])
        states, _, after = (jax.tree.map(np.asarray, part) for part in solve_ground_points(problem, start, folds))
    held = np.full(len(camera), np.nan)
    for fold, k in enumerate(mats, start=1):
        own = mat == k
        still = np.array([(folds[fold][camera == c] > 0).sum() >= _FEWEST for c in range(num)])
        held[own] = np.where(still[camera[own]], after[fold][own], np.nan)
    return MountFit(Rig(rig.cameras, states.T_base_cam[0][:num], rig.names), before, after[0], held, camera, p_base)


def _survey_camera() -> tuple[Camera, np.ndarray]:
    """A camera above the vehicle whose picture is the survey."""
    T_base_cam = T_base_bev()
    T_base_cam[2, 3] = _ABOVE_M
    return PinholeCamera(_ABOVE_PX, _ABOVE_PX, 0.0, 0.0, 10, 10), T_base_cam


def _weights(rig: Rig, camera: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Inverse of the ground that a pixel spans: one for the corner that is known best, less for others."""
    spans = np.zeros(len(uv))
    for index, own in enumerate(rig.cameras):
        at = camera == index
        T = np.asarray(rig.T_base_cam[index], np.float64)
        places = [_ground(own, T, uv[at] + off) for off in ([-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5])]
        du, dv = places[1] - places[0], places[3] - places[2]
        spans[at] = _CORNER_PX * np.sqrt((du**2 + dv**2).sum(axis=1)) + 0.0005
    return spans.min() / spans


def _ground(camera: Camera, T: np.ndarray, uv: np.ndarray) -> np.ndarray:
    ray = np.asarray(camera.unproject(uv)[0]) @ T[:3, :3].T
    return T[:2, 3] + (T[2, 3] / np.maximum(-ray[:, 2:], 1e-3)) * ray[:, :2]


def ground_errors(rig: Rig, truth: Rig, within_m: float = 3.0) -> Mapping[str, Float[np.ndarray, " n"]]:
    """How far a calibration puts points of the ground off [m], by camera: on a grid within reach of it, in its picture.

    Args:
        rig: the calibration.
        truth: the true cameras.
        within_m: distance on the ground from the camera.
    """
    found = {}
    for name, own, T_own, true, T_true in zip(
        rig.names, rig.cameras, np.asarray(rig.T_base_cam), truth.cameras, np.asarray(truth.T_base_cam), strict=True
    ):
        step = np.arange(-within_m, within_m + 0.01, 0.25)
        xy = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
        xy = T_true[:2, 3] + xy[np.linalg.norm(xy, axis=1) <= within_m]
        p_cam = (np.column_stack([xy, np.zeros(len(xy))]) - T_true[:3, 3]) @ T_true[:3, :3]
        uv, valid = (np.asarray(a) for a in true.project(p_cam))
        ahead = (xy - T_true[:2, 3]) @ T_true[:2, 2] > 0.0
        use = valid & ahead & np.asarray(true.in_image(uv[:, 0], uv[:, 1]))
        found[name] = np.linalg.norm(_ground(own, np.asarray(T_own, np.float64), uv[use]) - xy[use], axis=1)
    return found
