"""What is watched of calibration and map, and from when on it counts (room: localization; host).

In: nothing. Out: WatchConfig.
"""

from dataclasses import dataclass
from typing import ClassVar

from semloc_jax.evaluation.mixture_bounds import LEAST_LEVELS


@dataclass(frozen=True)
class WatchConfig:
    """What is watched, and from when on it counts. All values are ours."""

    level: ClassVar[int] = 1
    """Of the cost maps, on which lines and posts are compared: a repainted line lies tens of pixels aside."""
    aside_m: ClassVar[tuple[float, float]] = (1.5, 0.1)
    """How far aside lines and posts are compared, and in what steps."""
    ahead_m: ClassVar[tuple[float, float]] = (4.5, 0.25)
    radial_share: ClassVar[float] = 0.05
    """By how much a lens of another distortion is wider or narrower at the side of the image: as much as the distortion
    of usual lenses there."""
    width_m: ClassVar[float] = 0.2
    """By how much another road is wider or narrower than in the map."""
    turn_rad: ClassVar[float] = 0.015
    step_m: float = 0.5
    """Way between two frames that are looked at: from one place the same errors are seen again."""
    eager_looks: int = 12
    """So many frames at the start of a drive are asked for all that may be wrong with lenses, width and the yaw of all
    cameras: what is wrong is wrong from the first frame on."""
    memory_frames: float = 40.0
    memory_looks: ClassVar[float] = 10.0
    """Of each of the other calibrations at the least: with several cameras one of a dozen is asked a frame, and what
    the start of a drive has told would be forgotten three times as fast as it is told again."""
    share: float = 0.3
    """Share of what a frame says that is new: successive frames see the same map."""
    least_levels: tuple[float, float, float] = LEAST_LEVELS
    """No level is smaller; that of the heading is so much in every pose, since no camera is mounted exactly, and joins
    what scatters."""
    mount_sigma_deg: float = 1.0
    """How far a camera may be rolled or pitched in its mount, before the drive says more."""
    least_gain_nats: float = 2.0
    """What a frame must gain at least: less is left by masks and maps that are not perfect, in every frame anew."""
    width_gain_nats: ClassVar[tuple[float, float]] = (4.0, 0.5)
    """The same of the width of the road, where the pose has the height of its mounts, and where it has another one as
    if for that width. The first is beyond what a real drive said (2.6); lines of one side 0.2 m aside say 3, 0.3 m 3.5
    to 8, and sound simulated drives lose 6 and more."""
    width_height_m: ClassVar[tuple[float, float]] = (0.01, 0.03)
    """From the first height to the second. On sound drives, a real one among them, it is less than 0.005 m on average,
    with lines of one side 0.2 or 0.3 m aside 0.03 to 0.07 m."""
    count_nats: float = 2.5
    """A calibration that so much speaks for joins the protection levels: less is what chance does among a dozen."""
    class_gain_nats: ClassVar[float] = 0.5
    """What elements of a group alone must fit better elsewhere in a frame at least: on sound drives they fit best where
    the pose is, to the frame."""
    class_count_nats: ClassVar[float] = 1.0
    """Elements of one kind that were moved join the levels from so much on."""
    doubt_memory_m: ClassVar[float] = 8.0
    """Way over which what was spoken for still widens the levels: so long errors of masks may stay the same. A frame
    within them which does not say it again has not said otherwise."""
