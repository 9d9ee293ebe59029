"""Cameras of a surround view calibrated on points of the ground that two of them see (room: calibration; host).

In: a Rig and pairs of pixels. Out: GroundCalibration: the corrected rig, how far neighbouring cameras disagree before,
after, and on points that were held out.
"""

import csv
from dataclasses import dataclass, field
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.calibration.config import CalibrationPriors, Intrinsics
from semloc_jax.calibration.evidence import unknown_fields
from semloc_jax.calibration.ground_problem import GroundPointProblem, GroundState, solve_ground_points
from semloc_jax.calibration.observability import AXES, Observability, observe
from semloc_jax.calibration.self_calibration import lens_sigmas, mount_change
from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.storage import reading

_REASON = "points of the ground tell the cameras against each other only: a drive, or a survey, tells the vehicle"
_COLUMNS = ("camera_a", "u_a", "v_a", "camera_b", "u_b", "v_b")


@dataclass(frozen=True)
class GroundPairs:
    """Points of the ground, each seen by two cameras.

    Attributes:
        cameras: names of the two, one pair for each point.
        uv: float64[n 2 2], the pixel in each of them.
    """

    cameras: tuple[tuple[str, str], ...]
    uv: np.ndarray

    def __len__(self) -> int:
        """Number of points."""
        return len(self.cameras)


@dataclass(frozen=True)
class GroundPointConfig:
    """How mounts are found from ground points. All values are ours."""

    intrinsics: Intrinsics = "none"
    num_folds: int = 5
    """Parts of the points; each is held out once."""
    noise_m: float = 0.05
    """Distance that a careful hand and a flat ground leave."""
    smooth_m: float = 0.01
    """Distances below this count by their square."""
    seed: int = 0
    """Of the deal of points to folds."""
    observable_ratio: float = 0.35
    held_ratio: float = 0.8
    priors: CalibrationPriors = field(default_factory=lambda: CalibrationPriors(mount_m=0.1, mount_deg=3.0))
    """Mounts of a surround view are known from drawings only."""


@dataclass(frozen=True)
class GroundCalibration:
    """What ground points say about a surround view.

    Attributes:
        rig: The corrected cameras.
        before_m: Mean distance between what two cameras take for the same point, with the calibration to start from.
        after_m: With the corrected one.
        held_out_m: Of the points of each fold, with a rig that was made without them.
        held_out_before_m: Of the same points, with the calibration to start from.
        distances_m: float64[n], of each point, after.
        observability: Sigmas and verdicts; the vehicle's own frame is held by the priors alone.
    """

    rig: Rig
    before_m: float
    after_m: float
    held_out_m: tuple[float, ...]
    held_out_before_m: tuple[float, ...]
    distances_m: np.ndarray
    observability: Observability


def read_ground_pairs(path: str | Path) -> GroundPairs:
    """Pairs of a table with columns camera_a, u_a, v_a, camera_b, u_b, v_b; lines that begin with # are left out.

    Raises:
        SemlocError: no such file, a column is missing, or a pixel is no number.
    """
    path = Path(path)
    if not path.is_file():
        raise SemlocError(f"ground points {path}: no such file; expected a csv with columns {', '.join(_COLUMNS)}")
    with reading(f"ground points {path}"), path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    missing = [name for name in _COLUMNS if not rows or rows[0].get(name) is None]
    if missing:
        raise SemlocError(f"ground points {path}: no column {missing[0]}; expected {', '.join(_COLUMNS)}")
    try:
        uv = [[[float(row[f"{axis}_{side}"]) for axis in "uv"] for side in "ab"] for row in rows]
        if not np.isfinite(uv).all():
            raise ValueError("a pixel is NaN or infinite")
    except (TypeError, ValueError) as error:
        raise SemlocError(f"ground points {path}: {error}; expected pixels as numbers") from error
    return GroundPairs(tuple((row["camera_a"], row["camera_b"]) for row in rows), np.array(uv))


def calibrate_on_ground(rig: Rig, pairs: GroundPairs, config: GroundPointConfig | None = None) -> GroundCalibration:
    """Mounts (and lenses) under which neighbouring cameras see the same ground at the same place.

    This constrains the cameras relative to each other; their pose relative to the vehicle comes from the priors.

    Args:
        rig: The calibration to start from.
        pairs: At least three points for each camera.
        config: None for the defaults.

    Raises:
        SemlocError: an unknown camera, too few points, or a point whose line of sight does not meet the ground.
    """
    config = config or GroundPointConfig()
    index = np.array([[rig.index(name) for name in names] for names in pairs.cameras])
    _check(rig, pairs, index, config)
    fields = tuple(unknown_fields(camera, config.intrinsics) for camera in rig.cameras)
    mounts = np.tile([config.priors.mount_m] * 3 + [np.deg2rad(config.priors.mount_deg)] * 3, len(rig))
    lenses = lens_sigmas(rig, fields, config.priors)
    sigma = np.concatenate([mounts, lenses.ravel()])
    fold = np.random.default_rng(config.seed).permutation(np.arange(len(pairs)) % config.num_folds)
    weights = np.stack([np.ones(len(pairs)), *(fold != k for k in range(config.num_folds))]).astype(np.float64)
    with jax.enable_x64(True):
        T_base_cam = jnp.asarray(np.asarray(rig.T_base_cam, np.float64))
        problem = GroundPointProblem(
            rig.cameras, jnp.asarray(index), jnp.asarray(pairs.uv), jnp.ones(len(pairs)), T_base_cam,
            jnp.asarray(sigma), config.noise_m, config.smooth_m, fields,
        )  # fmt: skip
        start = GroundState(T_base_cam, jnp.zeros(lenses.shape))
        before = np.linalg.norm(np.asarray(eqx.filter_jit(problem.distances)(start)), axis=1)
        states, equations, after = (
            jax.tree.map(np.asarray, part) for part in solve_ground_points(problem, start, jnp.asarray(weights))
        )
    corrected = _corrected(rig, states.T_base_cam[0], states.intrinsics[0], fields)
    return GroundCalibration(
        corrected,
        float(before.mean()),
        float(after[0].mean()),
        tuple(float(after[k + 1][fold == k].mean()) for k in range(config.num_folds)),
        tuple(float(before[fold == k].mean()) for k in range(config.num_folds)),
        after[0],
        _observability(rig, corrected, equations.information[0], states.intrinsics[0], sigma, fields, config),
    )


def _check(rig: Rig, pairs: GroundPairs, index: np.ndarray, config: GroundPointConfig) -> None:
    counts = np.bincount(index.ravel(), minlength=len(rig))
    if counts.min() < 3 or len(pairs) < 2 * config.num_folds:
        raise SemlocError(
            f"ground points: {len(pairs)} pairs, {counts.min()} of camera {rig.names[int(counts.argmin())]}; expected "
            f"at least 3 for each camera and {2 * config.num_folds} in all; add points to the overlaps"
        )
    for k, (row, uv) in enumerate(zip(index, pairs.uv, strict=True)):
        for c, pixel in zip(row, uv, strict=True):
            ray, valid = (np.asarray(a) for a in rig.cameras[c].unproject(pixel))
            if not (valid and (np.asarray(rig.T_base_cam[c])[:3, :3] @ ray)[2] < -0.02):
                raise SemlocError(
                    f"ground points: pair {k} at ({pixel[0]:.0f}, {pixel[1]:.0f}) of camera {rig.names[c]} is not on "
                    "the ground below the horizon; expected points on the road beside the vehicle"
                )


def _corrected(rig: Rig, T_base_cam: np.ndarray, changes: np.ndarray, fields: tuple[tuple[str, ...], ...]) -> Rig:
    cameras = []
    for camera, names, change in zip(rig.cameras, fields, changes, strict=True):
        for k, name in enumerate(names):
            camera = eqx.tree_at(
                lambda c, n=name: getattr(c, n), camera, np.asarray(float(getattr(camera, name)) + change[k])
            )
        cameras.append(camera)
    return Rig(cameras, T_base_cam, rig.names)


def _observability(
    rig: Rig,
    corrected: Rig,
    information: np.ndarray,
    changes: np.ndarray,
    sigma: np.ndarray,
    fields: tuple[tuple[str, ...], ...],
    config: GroundPointConfig,
) -> Observability:
    turn, moved, names, units = np.eye(len(sigma)), [], [], []
    for c, name in enumerate(rig.names):
        R = corrected.T_base_cam[c][:3, :3]
        turn[6 * c : 6 * c + 3, 6 * c : 6 * c + 3] = turn[6 * c + 3 : 6 * c + 6, 6 * c + 3 : 6 * c + 6] = R
        moved.append(mount_change(np.asarray(rig.T_base_cam[c]), corrected.T_base_cam[c]))
        names += [f"{name} {axis}" for axis in AXES]
        units += ["m"] * 3 + ["deg"] * 3
    for name, own in zip(rig.names, fields, strict=True):
        padded = own + ("",) * (changes.shape[1] - len(own))
        names += [f"{name} {field}" for field in padded]
        units += ["px" if field in ("fx", "fy", "cx", "cy") else "" for field in padded]
    in_unit = np.where([unit == "deg" for unit in units], np.rad2deg(1.0), 1.0)
    free = np.flatnonzero(sigma > 0)
    return observe(
        (turn @ information @ turn.T)[np.ix_(free, free)],
        [names[k] for k in free],
        [units[k] for k in free],
        (np.concatenate([*moved, changes.ravel()]) * in_unit)[free],
        (sigma * in_unit)[free],
        config.observable_ratio,
        config.held_ratio,
        dict.fromkeys(AXES, _REASON),
    )
