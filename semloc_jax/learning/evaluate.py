"""How accurate and how honest a configuration is on a drive (room: learning; host).

In: a drive with truth, a LocalizeConfig. Out: Accuracy, from the fast solver as it is used.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.datasets import Sequence
from semloc_jax.geometry import rigid
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.loss import PLANAR, pose_nll
from semloc_jax.learning.scenes import prior_sigma
from semloc_jax.localization import FrameLocalizer, MaskSource
from semloc_jax.localization.run import LocalizeConfig
from semloc_jax.localization.single_frame import FrameInput, evidence_from
from semloc_jax.maps import SemanticMap
from semloc_jax.residuals.view import ViewConfig
from semloc_jax.solvers.pose import AlignConfig, Prior, align
from semloc_jax.structs import PoseEstimate

_LEVELS = (0, 1, 2, 3)


@dataclass(frozen=True)
class Accuracy:
    """Errors of the frames of a drive and what the solver said about them.

    Attributes:
        error: float64[n 3], along and across [m] and in heading [rad].
        covariance: float64[n 3 3].
        max_error_m: Frames farther from the truth are counted, not averaged.
    """

    error: np.ndarray
    covariance: np.ndarray

    max_error_m: float

    @property
    def is_near(self) -> np.ndarray:
        """bool[n], frames that did not end on another dash or pole: what the other numbers are of."""
        return np.hypot(self.error[:, 0], self.error[:, 1]) < self.max_error_m

    @property
    def num_far(self) -> int:
        """Frames that did."""
        return int(np.sum(~self.is_near))

    @property
    def position_m(self) -> float:
        """Mean distance to the truth in the plane."""
        return float(np.hypot(self.error[:, 0], self.error[:, 1])[self.is_near].mean())

    @property
    def heading_deg(self) -> float:
        """Mean absolute error in heading."""
        return float(np.degrees(np.abs(self.error[self.is_near, 2])).mean())

    @property
    def nees(self) -> float:
        """Mean normalised squared error for each direction: 1 where covariances are right."""
        return float(np.mean(self._likelihood()[1]))

    @property
    def nll(self) -> float:
        """Mean negative log-likelihood of the truth."""
        return float(np.mean(self._likelihood()[0]))

    def _likelihood(self) -> tuple[np.ndarray, np.ndarray]:
        near = self.is_near
        nll, nees = pose_nll(jnp.asarray(self.error[near]), jnp.asarray(self.covariance[near]))
        return np.asarray(nll), np.asarray(nees)


def evaluate(
    drive: Sequence,
    semantic_map: SemanticMap,
    masks: MaskSource,
    settings: LocalizeConfig,
    config: LearningConfig,
) -> Accuracy:
    """Frames of a drive aligned by the fast solver from priors that are off by seeded errors.

    Args:
        drive: With truth.
        semantic_map: Its map.
        masks: Its masks.
        settings: The configuration that is judged.
        config: Number of frames, error of the priors, seed; what learning changes is not taken from here.
    """
    localizer = FrameLocalizer(semantic_map, masks.table, settings)
    sigma, rng = prior_sigma(config), np.random.default_rng([config.seed, 1])
    step = replace(settings.frame.polish_align, levels=_LEVELS[: len(settings.cost_maps.ramp_px)])
    chosen = np.unique(np.linspace(0, len(drive) - 1, config.num_frames).astype(int))
    errors, covariances = [], []
    for index in chosen:
        frame = drive.frames[index]
        T_true = drive.truth_at(frame)
        T_prior = T_true @ rigid.exp(sigma * rng.normal(size=6))
        rig = masks.seen_by(frame.rig.select(masks.cameras))
        inputs, local_map = localizer.prepare(masks.masks(frame), rig, T_prior)
        T_prior[:3, 3] -= local_map.origin_map
        prior = Prior(jnp.asarray(T_prior, jnp.float32), jnp.asarray(sigma, jnp.float32))
        found = _aligned(inputs, prior, settings.frame.polish_view, step)
        T = np.asarray(found.T_map_base, np.float64)
        T[:3, 3] += local_map.origin_map
        errors.append(rigid.log(rigid.inverse(T_true) @ T)[PLANAR])
        covariances.append(np.asarray(found.covariance, np.float64)[np.ix_(PLANAR, PLANAR)])
    return Accuracy(np.array(errors), np.array(covariances), config.max_error_m)


@partial(jax.jit, static_argnames=("seen", "step"))
def _aligned(inputs: FrameInput, prior: Prior, seen: ViewConfig, step: AlignConfig) -> PoseEstimate:
    return align(prior.T_map_base, evidence_from(prior.T_map_base, inputs, seen), prior, step)
