"""How a drive calibrates its own sensors (room: calibration; host).

In: nothing. Out: SelfCalibrationConfig, MountPriors and the other parts of it.
"""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.alignment.level_choice import INLIER_LIMITS
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.motion_noise import MotionNoise

Intrinsics = Literal["none", "focal", "all"]
"""What of the lenses is unknown: nothing; focal lengths and centre; distortion too."""


@dataclass(frozen=True)
class CalibrationPriors:
    """How far off the calibration to start from may be: one standard deviation of each. All values are ours.

    A sigma of 0 keeps a quantity fixed.
    """

    mount_m: float = 0.05
    """Place of a camera along each axis: a tape measure, a changed bracket."""
    mount_deg: float = 2.0
    """Direction of a camera about each axis: a screwed bracket, a new windscreen."""
    focal_share: float = 0.01
    center_px: float = 5.0
    distortion: float = 0.02
    """Each coefficient of the lens polynomial."""
    odometer_scale: float = 0.02
    """Tyres: pressure, wear, another size of the same kind."""
    gyro_bias_degps: float = 0.3
    gnss_offset_m: float = 3.0
    stance_m: float = 0.01
    """Height of the rear axle against the nominal one over the whole drive: load."""
    stance_deg: float = 0.05
    """Roll and pitch against the road over the whole drive: load."""
    mask_px: float = 0.3
    """All masks against their images, beside the offset that is estimated from both: shading feigns as much."""


@dataclass(frozen=True)
class FrameFactors:
    """What constrains a frame besides its masks. All values are ours."""

    gnss_inflation: float = 3.0
    """Neighbouring fixes share most of their error: n fixes are worth n over the square of this."""
    gnss_reach_s: float = 0.3
    """A fix farther from a frame than this is not used."""
    reference_m: float = 0.03
    """Standard deviation of poses from elsewhere, where they are given."""
    reference_deg: float = 0.05
    side_slip_share: float = 0.003
    """Side slip of the rear axle as a share of the way, the same over 5 m; without wheels it is all that is known."""


@dataclass(frozen=True)
class SelfCalibrationConfig:
    """Everything that decides how a drive calibrates its sensors. All values are ours."""

    SECTION: ClassVar[str] = "calibrate"
    """Where a configuration file holds all of this but the scene."""
    scene: LocalizeConfig = field(default_factory=LocalizeConfig)
    num_frames: int = 40
    """Frames used, spread evenly over the way."""
    min_spacing_m: float = 0.7
    """Frames nearer to each other than this say the same."""
    intrinsics: Intrinsics = "none"
    levels: tuple[int, ...] = (0, 1, 2, 3)
    """Levels of the cost maps of the scene, coarsest first. The ramp of the last decides: what is hidden pulls as far
    as it reaches. Four fisheyes with masks of a network are 0.06 deg off with 3 px, 0.07 with 6, 0.09 with 8. Masks
    that are too thin on both sides of a line (by 0.2 to 0.4 px) turn no camera: estimated as well, they only added
    noise."""
    max_steps: int = 25
    """Most evaluations on each level."""
    tolerance: float = 2e-3
    """A level ends when a step is below this, in sigmas of the priors and in units of 10 cm and 0.6 deg of poses."""
    min_inlier_ratio: float = INLIER_LIMITS.calibration
    """A level with a smaller share of the visible contour within its ramp is left out."""
    observable_ratio: float = 0.35
    """A direction is observable where the drive leaves less than this share of its prior's sigma."""
    held_ratio: float = 0.8
    """It is held by the prior where the drive leaves more than this share; between the two it is weak."""
    priors: CalibrationPriors = field(default_factory=CalibrationPriors)
    factors: FrameFactors = field(default_factory=FrameFactors)
    motion: MotionNoise = field(default_factory=MotionNoise)

    def __post_init__(self) -> None:
        num = len(self.scene.cost_maps.ramp_px)
        if not self.levels or not set(self.levels) <= set(range(num)):
            raise SemlocError(f"calibration: levels {self.levels}; expected some of 0 ... {num - 1}, coarsest first")
        if self.num_frames < 2:
            raise SemlocError(f"calibration: num_frames = {self.num_frames}; expected several frames, 40 is usual")
