"""Where the vehicle was, as far as the masks at hand tell (room: learning; host).

In: a drive, its map, masks. Out: TeacherPose of the frames that are good enough to teach.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.pose_prior import PriorSource
from semloc_jax.datasets import Drive, Frame
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.localization.drive import track_frames
from semloc_jax.localization.frame_by_frame import iterate_frames
from semloc_jax.maps import SemanticMap

_FLOOR = np.array([0.02, 0.02, 0.02, 0.002, 0.002, 0.001])
"""No pose is known better than this along, across, up [m] and in roll, pitch, heading [rad]: a label that is drawn
more sharply teaches the errors of the pose."""


@dataclass(frozen=True)
class TeacherLimits:
    """Which poses may teach: stated standard deviations."""

    lateral_m: float = 0.15
    longitudinal_m: float = 0.5
    heading_deg: float = 0.6

    def hold(self, covariance: Float[np.ndarray, "6 6"]) -> bool:
        """Whether a pose of this covariance may."""
        along, across, heading = np.sqrt(np.diag(covariance)[[0, 1, 5]])
        return bool(
            along <= self.longitudinal_m and across <= self.lateral_m and np.degrees(heading) <= self.heading_deg
        )


@dataclass(frozen=True)
class TeacherPose:
    """A frame whose pose is known well enough.

    Attributes:
        frame: The frame.
        T_map_base: Its pose.
        covariance: Of the right tangent, with a floor.
    """

    frame: Frame
    T_map_base: np.ndarray
    covariance: np.ndarray


def teacher_poses(
    drive: Drive,
    semantic_map: SemanticMap,
    masks: MaskSource,
    frames: Sequence[Frame],
    prior: PriorSource | None,
    limits: TeacherLimits,
) -> list[TeacherPose]:
    """Poses of the frames that may teach.

    A drive with wheels or an inertial sensor is tracked through all of its frames, so that a stretch in which the masks
    say little is bridged; frames of others are searched one by one, and those that are accepted teach.

    Args:
        drive: The drive.
        semantic_map: Its map.
        masks: What there is: classical, a network.
        frames: In order of time.
        prior: First guess of a pose; None for satellite fixes.
        limits: Of their stated standard deviations.
    """
    if drive.odometry is not None or drive.imu is not None:
        results = track_frames(drive, semantic_map, masks, prior, frames)
        by_id = {frame.id: frame for frame in frames}
        found = [(by_id[r.frame_id], r.fused.T_map_base, r.fused.covariance) for r in results if r.fused and r.accepted]
    else:
        results = iterate_frames(drive, semantic_map, masks, prior or "gnss", frames)
        found = [(r.frame, r.T_map_base, r.covariance) for r in results if r.localized]
    floor = np.diag(_FLOOR**2)
    return [TeacherPose(frame, T, covariance + floor) for frame, T, covariance in found if limits.hold(covariance)]
