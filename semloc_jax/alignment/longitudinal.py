"""Where along the road, when the masks hardly constrain it (room: alignment; host).

In: a predicted pose whose longitudinal position is less sure than a solve can bridge. Out: the pose moved along the
road. Whether to search is decided by information, not by a rule about the scene: by how far the prediction may be off
along the road against the basin of a solve, and by what the masks of the last frame held along the road.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.pose import Prior
from semloc_jax.alignment.single_frame import FrameInput
from semloc_jax.alignment.tracking_step import TrackAlignConfig, profile_beside


@dataclass(frozen=True)
class LongitudinalConfig:
    """When and how the position along the road is searched first. All values are ours."""

    basin_m: float = 0.25
    """The basin of a solve along the road; where three sigmas of the prediction reach farther, the road is searched."""
    weak_sigma_m: float = 0.15
    """The road is searched where the sigma of the last masks alone was larger than this."""
    reach_sigmas: float = 3.0
    max_reach_m: float = 8.0
    num_offsets: int = 65
    level: int = 1
    """Level of the cost maps: a ramp wide enough that no stop line or dash end falls between two offsets."""


def is_searched(sigma_m: float, last_sigma_m: float, config: LongitudinalConfig) -> bool:
    """Whether the position along the road is searched before the solve.

    Args:
        sigma_m: Standard deviation of the prediction along the road [m].
        last_sigma_m: What the masks of the last frame alone held along the road [m].
        config: Limits.
    """
    reaches_out = config.reach_sigmas * sigma_m > config.basin_m
    return reaches_out or last_sigma_m > max(config.weak_sigma_m, 2.0 * sigma_m)


def corrected_along(
    T_predicted: Float[np.ndarray, "4 4"],
    sigma_m: float,
    prior: Prior,
    frame: FrameInput,
    trust: Float[np.ndarray, " element"],
    align: TrackAlignConfig,
    config: LongitudinalConfig,
) -> tuple[np.ndarray, float]:
    """The predicted pose moved to where stop lines, dash ends, poles and signs fit best, and by how much [m].

    Args:
        T_predicted: Predicted pose relative to the local origin.
        sigma_m: Its standard deviation along the road [m].
        prior: Holds the pose across the road and in attitude, where nothing else does.
        frame: Samples, cost maps, cameras.
        trust: Weight of each map element.
        align: View and noise.
        config: Reach and level.
    """
    reach_m = float(np.clip(config.reach_sigmas * sigma_m, config.basin_m, config.max_reach_m))
    offsets = np.linspace(-reach_m, reach_m, config.num_offsets)
    sigma, moves = np.array(prior.sigma), np.zeros((config.num_offsets, 3), np.float32)
    sigma[0], moves[:, 0] = np.inf, offsets
    free = Prior(prior.T_map_base, sigma, prior.terms)
    T, level = np.asarray(T_predicted, np.float32), np.asarray(config.level)
    costs = profile_beside(T, moves, free, frame, trust, align, level)
    # The prior of a solve is loose; which of several dashes is meant, the prediction itself helps to tell.
    best_m = float(offsets[int(np.argmin(align.score_share * np.asarray(costs) + 0.5 * (offsets / sigma_m) ** 2))])
    moved = T_predicted.copy()
    moved[:3, 3] += best_m * T_predicted[:3, 0]
    return moved, best_m
