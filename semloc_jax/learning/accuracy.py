"""How accurate and how honest a configuration is on a drive (room: learning; host).

In: a drive with truth, a LocalizeConfig. Out: Accuracy, from the search as it is used.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.localized import localized_frames
from semloc_jax.learning.loss import PLANAR, pose_nll
from semloc_jax.maps import SemanticMap

_JUDGE_SEED = 1000
"""Priors of the judged frames are others than those that were learned from."""


@dataclass(frozen=True)
class Accuracy:
    """Errors of the frames of a drive, and the covariances that the solver stated.

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
        return float(self._near_m().mean())

    @property
    def p95_m(self) -> float:
        """Distance to the truth that 95 % of the frames do not exceed."""
        return float(np.percentile(self._near_m(), 95))

    @property
    def heading_deg(self) -> float:
        """Mean absolute error in heading."""
        return float(np.degrees(np.abs(self.error[self.is_near, 2])).mean())

    def _near_m(self) -> np.ndarray:
        return np.hypot(self.error[:, 0], self.error[:, 1])[self.is_near]

    @property
    def nees(self) -> float:
        """Mean normalised squared error for each direction: 1 where covariances are right."""
        return float(np.mean(self._likelihood()[1]))

    @property
    def nees_median(self) -> float:
        """Median of the same: 0.79 where covariances are right, whatever a few frames say."""
        return float(np.median(self._likelihood()[1]))

    def within(self, sigmas: float) -> float:
        """Share of the errors along, across and in heading within so many of their standard deviations."""
        near = self.is_near
        sigma = np.sqrt(np.diagonal(self.covariance[near], axis1=1, axis2=2))
        return float(np.mean(np.abs(self.error[near]) < sigmas * sigma))

    @property
    def nll(self) -> float:
        """Mean negative log-likelihood of the truth."""
        return float(np.mean(self._likelihood()[0]))

    def _likelihood(self) -> tuple[np.ndarray, np.ndarray]:
        near = self.is_near
        nll, nees = pose_nll(jnp.asarray(self.error[near]), jnp.asarray(self.covariance[near]))
        return np.asarray(nll), np.asarray(nees)


def localizer_accuracy(
    drive: Drive, semantic_map: SemanticMap, masks: MaskSource, settings: LocalizeConfig, config: LearningConfig
) -> Accuracy:
    """Errors of frames of a drive, as the localizer finds them.

    Args:
        drive: With truth.
        semantic_map: Its map.
        masks: Its masks.
        settings: The configuration that is judged.
        config: Number of frames, errors of priors; what learning changes is not taken from here.

    Raises:
        SemlocError: no frame is near the truth.
    """
    localizer = FrameLocalizer(semantic_map, masks.table, settings)
    found = [
        (frame.T_true, frame.result.T_map_base, frame.result.modes[0].covariance)
        for frame in localized_frames(drive, localizer, masks, config, _JUDGE_SEED)
    ]
    shapes = (4, 4), (4, 4), (6, 6)
    T_true, T_found, covariance = (
        np.array([one[k] for one in found]).reshape(len(found), *shape) for k, shape in enumerate(shapes)
    )
    error = rigid.log(rigid.inverse(T_true) @ T_found)[:, PLANAR]
    accuracy = Accuracy(error, covariance[:, PLANAR][:, :, PLANAR], config.max_error_m)
    if not accuracy.is_near.any():
        raise SemlocError(
            f"drive {drive.name}: of {config.num_frames} frames {len(found)} were localized and none within "
            f"{config.max_error_m:g} m of the truth, so nothing can be judged; expected masks that show the map, "
            "or more frames (--num-frames)"
        )
    return accuracy
