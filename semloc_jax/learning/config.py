"""What is learned from drives with truth, and how (room: learning; host).

In: nothing. Out: LearningConfig.
"""

from dataclasses import dataclass, field
from typing import ClassVar

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.errors import SemlocError


@dataclass(frozen=True)
class LearningConfig:
    """Everything that decides what is learned. All values are our choice."""

    SECTION: ClassVar[str] = "learn"
    """Where a configuration file holds all of this but the scene."""
    scene: LocalizeConfig = field(default_factory=LocalizeConfig)
    """The configuration to start from."""
    num_frames: int = 16
    """Frames of each drive, spread evenly over it."""
    sigma_m: float = 1.0
    """Standard deviation of the prior along and across the road, as a satellite fix has it."""
    sigma_deg: float = 3.0
    stored_ramp_px: float = 10.0
    """Ramp of the cost maps that are learned on: the widest kernel that can be learned."""
    stored_stride: int = 2
    max_error_m: float = 0.3
    """A frame that ends farther from the truth than this is on another dash or pole, or sees nothing: no weight nor
    noise mends that. It is counted, and left out of what is learned and judged."""
    weight_sigma: float = 0.5
    """Standard deviation of the logarithm of a class weight about 1: few frames shall not silence a class."""
    ramp_sigma: float = 0.5
    """Of the logarithm of the ramp about its default."""
    tilt_sigma: float = 0.5
    """Of the logarithm of the tilt against the road about its default."""
    correlation_sigma: float = 1.0
    """Of the logarithm of the correlation length about its default."""
    independent_share: float = 0.1
    """Share of the frames that count against those standard deviations: those of a drive share its road and map."""
    tail_dof: float = 4.0
    """Degrees of freedom of the Student distribution that errors are taken from while weights and ramp are learned: few
    frames that end beside their place shall not outweigh all others."""
    max_gradient: float = 3.0
    """Longest gradient of one frame [nats], by the logarithms that are learned."""
    num_steps: int = 80
    """Of Adam."""
    batch: int = 40
    """Frames of one step."""
    rate: float = 0.05
    """Of Adam at its begin; it falls to zero."""
    num_calibrations: int = 2
    """Times that the drives for validation are searched to find how wide the covariance has to be; 0 leaves it as wide
    as single solves need it."""
    judge_every: int = 10
    """Steps between evaluations on the frames for validation; the best parameters are kept."""
    seed: int = 0
    """Of the priors' errors and of the batches."""

    def __post_init__(self) -> None:
        for name in ("num_frames", "num_steps", "batch", "judge_every"):
            if getattr(self, name) < 1:
                raise SemlocError(f"learning: {name} = {getattr(self, name)}; expected at least 1")
