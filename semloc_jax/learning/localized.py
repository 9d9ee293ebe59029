"""Frames of a drive, localized as in operation (room: learning; host).

In: a drive with truth, a FrameLocalizer. Out: LocalizedFrame: the result, what it was found from, and the truth.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.inputs.priors import prior_source
from semloc_jax.learning.config import LearningConfig


@dataclass(frozen=True)
class LocalizedFrame:
    """One frame.

    Attributes:
        prior: The prior of the search.
        result: What it found; at least one mode.
        T_true: True T_map_base in the map, float64.
    """

    prior: PosePrior
    result: LocalizationResult
    T_true: np.ndarray


def localized_frames(
    drive: Drive, localizer: FrameLocalizer, masks: MaskSource, config: LearningConfig, seed: int
) -> Iterator[LocalizedFrame]:
    """Frames spread evenly over a drive, each one searched from a prior that is off by seeded errors.

    The whole search, not one solve from near the truth: that ends on a wrong dash where the search does not, and what
    would be learned is how wrong a localizer is that nobody uses.

    Raises:
        SemlocError: the drive has no truth.
    """
    if drive.truth is None:
        raise SemlocError(f"drive {drive.name}: has no truth to learn from; expected poses_body.tum")
    give_prior = prior_source("truth", drive, config.sigma_m, config.sigma_deg, seed)
    for index in np.unique(np.linspace(0, len(drive) - 1, config.num_frames).astype(int)):
        frame = drive.frames[index]
        rig, prior = masks.seen_by(frame.rig.select(masks.cameras)), give_prior(frame)
        result = localizer.localize(frame, masks.masks(frame), prior, rig)
        if result.modes:
            yield LocalizedFrame(prior, result, drive.truth_at(frame))
