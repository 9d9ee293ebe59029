"""How well masks place held-out frames (room: learning; host).

In: a drive with truth, its map, masks. Out: RoundScore, from the search as it is used.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Drive, Frame
from semloc_jax.evaluation.metrics import ErrorLimit, pose_errors
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.inputs.priors import prior_source
from semloc_jax.localization.frame_by_frame import iterate_frames
from semloc_jax.maps import SemanticMap

FALSE_BEYOND = ErrorLimit("false", 0.5, 1.0, 2.0)
"""A pose that is accepted and farther off than this across, along [m] or in heading [deg] is false."""


class RoundScore(NamedTuple):
    """Held-out frames with one set of masks.

    Args:
        num_frames: Frames that were judged.
        num_found: Of them with a pose, accepted or not.
        num_accepted: Poses that may be used.
        num_false: Of these, far from the truth.
        median: Median absolute error of all poses found: lateral [m], longitudinal [m], heading [deg].
        p95: 95th percentile of the same.
        within: Shares of errors within 1, 2 and 3 of their stated standard deviations, all three directions together.
    """

    num_frames: int
    num_found: int
    num_accepted: int
    num_false: int
    median: tuple[float, float, float]
    p95: tuple[float, float, float]
    within: tuple[float, float, float]

    def is_better_than(self, other: "RoundScore") -> bool:
        """In recall and in the median along and across, without more false poses."""
        nearer = np.hypot(*self.median[:2]) < np.hypot(*other.median[:2])
        return self.num_false <= other.num_false and self.num_accepted >= other.num_accepted and bool(nearer)


def judged(
    drive: Drive,
    semantic_map: SemanticMap,
    masks: MaskSource,
    frames: Sequence[Frame],
    sigma_m: float,
    sigma_deg: float,
    seed: int,
) -> RoundScore:
    """The score of masks on frames, each searched from the truth plus seeded noise of the stated sigmas.

    Raises:
        SemlocError: the drive has no truth.
    """
    prior = prior_source("truth", drive, sigma_m, sigma_deg, seed)
    results = list(iterate_frames(drive, semantic_map, masks, prior, frames))
    found = [result for result in results if result.modes]
    if not found:
        nothing = (float("inf"),) * 3
        return RoundScore(len(results), 0, 0, 0, nothing, nothing, (0.0, 0.0, 0.0))
    T = np.stack([result.T_map_base for result in found])
    errors = _three(T, np.stack([drive.truth_at(result.frame) for result in found]))
    sigma = np.sqrt(np.array([np.diag(result.covariance)[[1, 0, 5]] for result in found])) * [1, 1, np.degrees(1)]
    accepted = np.array([result.localized for result in found])
    limits = FALSE_BEYOND.lateral_m, FALSE_BEYOND.longitudinal_m, FALSE_BEYOND.heading_deg
    return RoundScore(
        len(results),
        len(found),
        int(accepted.sum()),
        int(((errors > limits).any(axis=1) & accepted).sum()),
        tuple(np.median(errors, axis=0).tolist()),
        tuple(np.percentile(errors, 95, axis=0).tolist()),
        tuple(float(np.mean(errors < k * sigma)) for k in (1, 2, 3)),
    )


def _three(T: Float[np.ndarray, "n 4 4"], T_true: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 3"]:
    """Absolute errors across [m], along [m] and in heading [deg]."""
    errors = pose_errors(T, T_true)
    return np.abs(np.stack([errors["lateral_m"], errors["longitudinal_m"], errors["heading_deg"]], axis=1))
