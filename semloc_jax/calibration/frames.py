"""Frames of a drive to calibrate with, and where the vehicle was in them, roughly (room: calibration; host).

In: a Drive, a map, masks and a prior. Out: frames spread over the way, start poses that fit the driven way.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import jax
import numpy as np

from semloc_jax.alignment.pose_prior import PriorSource, RoadSigmas
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.calibration.config import SelfCalibrationConfig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.pose_factors import GraphConfig, measured_poses, odometry, pose_graph, prior, values_of
from semloc_jax.fusion.prediction import MotionIncrement, MotionLog, MotionQuality
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.localization.frame_by_frame import localize_frames
from semloc_jax.maps import SemanticMap
from semloc_jax.solvers.front import Arrow, solve
from semloc_jax.solvers.graph import FactorGraph, Values

MIN_FRAMES = 5
"""Fewer frames say next to nothing about six numbers of a mount."""
_START_SIGMA = np.array([0.5, 0.5, 0.15, 0.035, 0.035, 0.035])
"""Of a pose that was found with a wrong calibration [m, rad]; ours."""
_START_THRESHOLD = 3.0
"""Norm of a whitened pose difference (6 numbers) beyond which its pull grows no more; ours."""
_LOST_FACTOR = 5.0
"""A pose whose verdict was bad counts with so many times that sigma."""
_STILL = np.array([1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4])
"""Least standard deviation of a motion [m, rad]: wheels that stand know it exactly, and exact motion has no equations;
ours."""


@dataclass(frozen=True)
class StartPoses:
    """Frames and where they roughly are.

    Attributes:
        frames: In time order.
        T_map_base: float64[n 4 4], map frame.
        motion: Increment to the next frame, one less than frames; None where there are no wheels.
    """

    frames: tuple[Frame, ...]
    T_map_base: np.ndarray
    motion: tuple[MotionIncrement, ...] | None


def choose_frames(drive: Drive, num: int, min_spacing_m: float) -> tuple[Frame, ...]:
    """At most `num` frames, evenly spread over the driven way; over the time where nothing says how far it was.

    A vehicle that stands for the whole drive gives frames spread over the time: they carry little
    information, which the observability shows.

    Raises:
        SemlocError: the drive has too few frames.
    """
    if len(drive) < MIN_FRAMES:
        raise SemlocError(
            f"drive {drive.name}: has {len(drive)} frames; expected at least {MIN_FRAMES} to calibrate with; record a "
            "longer drive"
        )
    time_s = np.array([frame.time_s for frame in drive.frames])
    way_m = drive.odometry.distance_m(time_s) if drive.odometry is not None else time_s - time_s[0]
    length_m = way_m[-1] - way_m[0]
    if drive.odometry is not None:
        num = max(min(num, int(length_m / min_spacing_m) + 1), min(num, 2 * MIN_FRAMES))
        way_m = way_m + 1e-6 * (time_s - time_s[0])
    marks = np.linspace(way_m[0], way_m[-1], num)
    nearest = np.unique([int(np.argmin(np.abs(way_m - mark))) for mark in marks])
    if len(nearest) < MIN_FRAMES:
        nearest = np.unique(np.linspace(0, len(drive) - 1, MIN_FRAMES).astype(int))
    return tuple(drive.frames[i] for i in nearest)


def start_poses(
    drive: Drive,
    semantic_map: SemanticMap,
    masks: MaskSource,
    prior: PriorSource,
    config: SelfCalibrationConfig,
    on_frame: Callable[[LocalizationResult], None] | None = None,
) -> StartPoses:
    """Chosen frames localized with the calibration as it is, then made consistent with the driven way.

    The localizer lets the vehicle stand as far off the road as the mount may be wrong: for one camera, a wrong mount
    and a tilted vehicle look alike.
    """
    chosen = choose_frames(drive, config.num_frames, config.min_spacing_m)
    tilt_deg = float(np.hypot(config.priors.mount_deg, config.scene.road.roll_pitch_deg))
    height_m = float(np.hypot(2.0 * config.priors.mount_m, config.scene.road.height_m))
    settings = replace(config.scene, road=RoadSigmas(height_m, tilt_deg))
    found = localize_frames(drive, semantic_map, masks, prior, chosen, config=settings, on_frame=on_frame)
    found = [result for result in found if np.isfinite(result.T_map_base).all()]
    if len(found) < MIN_FRAMES:
        raise SemlocError(
            f"drive {drive.name}: {len(found)} of {len(chosen)} frames could be placed in map {semantic_map.name}; "
            f"expected at least {MIN_FRAMES}; check masks, map and prior, or correct the calibration by hand first"
        )
    frames = tuple(result.frame for result in found)
    motion = motion_between(drive, frames, config)
    poses = np.array([result.T_map_base for result in found])
    is_good = np.array([result.localized for result in found])
    return StartPoses(frames, poses if motion is None else smoothed(poses, is_good, motion), motion)


def motion_between(
    drive: Drive, frames: Sequence[Frame], config: SelfCalibrationConfig
) -> tuple[MotionIncrement, ...] | None:
    """Motion from each frame to the next by wheels and gyroscope; None where there are no wheels."""
    if drive.odometry is None:
        return None
    log = MotionLog.of_drive(drive, config.motion)
    found = tuple(log.increment(first.time_s, second.time_s) for first, second in pairwise(frames))
    if any(increment.quality is MotionQuality.MISSING for increment in found):
        return None
    return tuple(step._replace(covariance=step.covariance + np.diag(_STILL**2)) for step in found)


def smoothed(poses: np.ndarray, is_good: np.ndarray, motion: Sequence[MotionIncrement]) -> np.ndarray:
    """The poses that fit the found ones and the driven way best; a found pose that does not fit hardly counts."""
    num = len(poses)
    frame = LocalFrame(poses[0, :3, 3])
    local = frame.from_map(poses, np.float64)
    sigma = _START_SIGMA * np.where(is_good, 1.0, _LOST_FACTOR)[:, None]
    covariances = np.stack([increment.covariance for increment in motion])
    start, calibration = np.arange(num - 1), np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    factors = (
        measured_poses(local, np.stack([np.diag(1.0 / row) for row in sigma]), _START_THRESHOLD),
        odometry(
            start,
            start + 1,
            np.stack([increment.T_from_to for increment in motion]),
            np.stack([increment.jacobian for increment in motion]),
            np.stack([np.array(increment.calibration) for increment in motion]),
            np.linalg.inv(np.linalg.cholesky(covariances)),
        ),
        prior(local[0], calibration, np.diag(1.0 / np.array([*[100.0] * 6, 0.02, 0.005, 0.005, 1.0, 1.0]))),
    )
    graph = pose_graph(np.ones(num, bool), factors)
    with jax.enable_x64(True):
        solved = np.array(_smoothed(graph, values_of(local, calibration))["pose"])
    return frame.to_map(solved)


@jax.jit
def _smoothed(graph: FactorGraph, values: Values) -> Values:
    return solve(graph, values, GraphConfig().solve, Arrow(("pose",))).value
