"""Frames of a drive solved by the fast solver, as it is used (room: learning; host).

In: a drive with truth, a FrameLocalizer. Out: FastSolve: the estimate, what it was found from, and the truth.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.cameras import Rig
from semloc_jax.datasets import Frame, Sequence
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.learning.config import LearningConfig
from semloc_jax.localization import FrameLocalizer, MaskSource
from semloc_jax.localization.single_frame import FrameInput, evidence_from
from semloc_jax.residuals.view import ViewConfig
from semloc_jax.solvers.pose import AlignConfig, Prior, align
from semloc_jax.structs import PoseEstimate


@dataclass(frozen=True)
class FastSolve:
    """One frame; poses are T_map_base relative to the local origin, float64.

    Attributes:
        frame: The frame.
        rig: Cameras of its masks.
        inputs: Samples and cost maps.
        T_true: True pose.
        T_prior: Centre of the prior.
        T_found: The estimate.
        covariance: float64[6 6] of its right tangent.
    """

    frame: Frame
    rig: Rig
    inputs: FrameInput
    T_true: np.ndarray
    T_prior: np.ndarray
    T_found: np.ndarray
    covariance: np.ndarray


def fast_solves(
    drive: Sequence, localizer: FrameLocalizer, masks: MaskSource, config: LearningConfig, seed: int
) -> Iterator[FastSolve]:
    """Frames spread evenly over a drive, with priors that are off by seeded errors.

    A solve starts where a search ends, some centimetres from the truth: which of several dashes is the right one is the
    search's to tell, and one wrong dash would hide what all other frames say.

    Raises:
        SemlocError: the drive has no truth.
    """
    if drive.truth is None:
        raise SemlocError(f"drive {drive.name}: has no truth to learn from; expected poses_body.tum")
    settings, rng = localizer.config, np.random.default_rng([config.seed, seed])
    sigma = prior_sigma(config)
    start_sigma = np.array([config.start_m, config.start_m, 0.0, 0.0, 0.0, np.deg2rad(config.start_deg)])
    for index in np.unique(np.linspace(0, len(drive) - 1, config.num_frames).astype(int)):
        frame = drive.frames[index]
        T_true = drive.truth_at(frame)
        T_prior = T_true @ rigid.exp(sigma * rng.normal(size=6))
        T_start = T_true @ rigid.exp(start_sigma * rng.normal(size=6))
        rig = masks.seen_by(frame.rig.select(masks.cameras))
        inputs, local_map = localizer.prepare(masks.masks(frame), rig, T_prior)
        for T in (T_true, T_prior, T_start):
            T[:3, 3] -= local_map.origin_map
        prior = Prior(jnp.asarray(T_prior, jnp.float32), jnp.asarray(sigma, jnp.float32))
        start = jnp.asarray(T_start, jnp.float32)
        found = _aligned(start, inputs, prior, settings.frame.polish_view, settings.frame.polish_align)
        T_found, covariance = (np.asarray(part, np.float64) for part in (found.T_map_base, found.covariance))
        yield FastSolve(frame, rig, inputs, T_true, T_prior, T_found, covariance)


def prior_sigma(config: LearningConfig) -> np.ndarray:
    """Standard deviations (x, y, z [m], roll, pitch, yaw [rad]) of the prior of a frame."""
    road = config.localize.road
    tilt = np.deg2rad(road.roll_pitch_deg)
    return np.array([config.sigma_m, config.sigma_m, road.height_m, tilt, tilt, np.deg2rad(config.sigma_deg)])


@partial(jax.jit, static_argnames=("seen", "step"))
def _aligned(
    T_start: Float[Array, "4 4"], inputs: FrameInput, prior: Prior, seen: ViewConfig, step: AlignConfig
) -> PoseEstimate:
    return align(T_start, evidence_from(T_start, inputs, seen), prior, step)
