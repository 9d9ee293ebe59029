"""Whether a place along the road is searched before a solve (room: alignment; host).

In: how sure the prediction and the masks of the last frame are along the road. Out: whether to search, and how; the
search itself is `tracking_step.moved_along`. What decides is information, not a rule about the scene: how far the
prediction may be off along the road against the basin of a solve, and what the masks of the last frame held.
"""

from dataclasses import dataclass


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
