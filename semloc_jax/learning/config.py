"""What is learned from drives with truth, and how (room: learning; host).

In: nothing. Out: LearningConfig.
"""

from dataclasses import dataclass, field

from semloc_jax.errors import SemlocError
from semloc_jax.localization.run import LocalizeConfig
from semloc_jax.solvers.implicit import SmoothConfig


@dataclass(frozen=True)
class LearningConfig:
    """Everything that decides what is learned. All values are ours."""

    num_frames: int = 16
    """Frames of each drive, spread evenly over it."""
    sigma_m: float = 0.25
    """Standard deviation of the prior along and across the road: what a tracker knows before it looks."""
    sigma_deg: float = 0.7
    start_m: float = 0.05
    """What a search leaves along and across the road: where the judged solves start."""
    start_deg: float = 0.1
    stored_ramp_px: float = 10.0
    """Ramp of the cost maps that are learned on: the widest kernel that can be learned."""
    stored_stride: int = 2
    max_error_m: float = 0.3
    """A solve that ends farther from the truth than this is on another dash or pole, or sees nothing: no weight nor
    noise mends that. It is counted, and left out of what is learned and judged."""
    weight_sigma: float = 0.5
    """Standard deviation of the logarithm of a class weight about 1: few frames shall not silence a class."""
    ramp_sigma: float = 0.5
    """Of the logarithm of the ramp about its default."""
    correlation_sigma: float = 1.0
    """Of the logarithm of the correlation length about its default."""
    max_iterations: int = 25
    seed: int = 0
    """Of the priors' errors."""
    localize: LocalizeConfig = field(default_factory=LocalizeConfig)
    """The configuration to start from."""
    smooth: SmoothConfig = field(default_factory=SmoothConfig)

    def __post_init__(self) -> None:
        if self.num_frames < 1 or self.max_iterations < 1:
            raise SemlocError(
                f"learning: num_frames = {self.num_frames}, max_iterations = {self.max_iterations}; expected at least 1"
            )
