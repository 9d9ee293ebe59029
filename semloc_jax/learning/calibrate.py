"""How wide the covariance has to be (room: learning; host).

In: what was learned, drives with truth. Out: the same with the correlation length at which the NEES is 1.
"""

from collections.abc import Sequence

import numpy as np

from semloc_jax.datasets import Drive
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.learning.accuracy import localizer_accuracy
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.parameters import Learned, learned_config
from semloc_jax.maps import SemanticMap

_BOUNDS_PX = (10.0, 1000.0)
"""Of the correlation length: from the cell of a network that works at a quarter of the resolution to a whole edge of an
image. Few frames, all better than stated, would ask for less, until none is found any more. Ours."""
_SLOPE = -1.1
"""Of the logarithm of the NEES by that of the length, until two lengths were tried: information goes with its inverse,
and weights of modes that are merged sharpen with it. Ours, measured."""


def calibrated(
    learned: Learned, drives: Sequence[tuple[Drive, SemanticMap, MaskSource]], config: LearningConfig
) -> Learned:
    """What was learned, with the correlation length at which the mean NEES of the search on the drives is 1.

    Weights and ramp are learned from single solves with a heavy-tailed likelihood, for which frames that end beside
    their place are exceptions. For a user they are not, and a search merges modes that lie close together: how wide the
    covariance has to be is asked of the whole search, and of all frames alike.

    Args:
        learned: What was learned.
        drives: Each with its map and masks.
        config: Number of frames, errors of priors, number of trials.
    """
    tried: list[tuple[float, float]] = []
    length_px = learned.correlation_px
    for _ in range(config.num_calibrations):
        settings = learned_config(learned._replace(correlation_px=length_px), config.scene)
        found = [localizer_accuracy(*drive, settings, config) for drive in drives]
        nees = sum(one.nees * np.sum(one.is_near) for one in found) / sum(np.sum(one.is_near) for one in found)
        tried.append((np.log(length_px), np.log(nees)))
        length_px = float(np.clip(np.exp(_where_zero(tried)), *_BOUNDS_PX))
    return learned._replace(correlation_px=round(length_px, 2))


def _where_zero(tried: Sequence[tuple[float, float]]) -> float:
    """Where the line through the last two points is zero; with the expected slope where they do not tell one."""
    (x, y), slope = tried[-1], _SLOPE
    if len(tried) > 1 and abs(x - tried[-2][0]) > 0.1:
        measured = (y - tried[-2][1]) / (x - tried[-2][0])
        slope = measured if -2.0 < measured < -0.5 else _SLOPE
    return x - y / slope
