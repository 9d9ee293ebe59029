"""Whether a track stands on the right period of the markings (room: localization; host).

In: FusedPose of a track, the last satellite fixes. Out: nats that speak against it, a sentence where they are many.
A pose that is a period of dashes off fits every frame: what gives way is what the fusion is free to move, the offset of
the satellites and the scale of the odometer. Both are held against what is known of them.
"""

from collections.abc import Sequence

import numpy as np

from semloc_jax.fusion.measurements import FusedPose, SensorBeliefs
from semloc_jax.localization.track_state import Fixes

_SIGMA_INFLATION = 1.5
"""Neighbouring fixes share errors that their stated sigma does not hold; as for a search around them."""
_LEAST_SIGMA_M = 1.0
_WRONG_SHARE = 0.05
"""Share of tracks that begin at another period of the markings, since one frame often sees no post. Ours. With fixes
of 1.3 m a right track is doubted once in a thousand, and one that is 12 m off practically always; of those 6 m off one
in six is not: posts and time must settle it."""
EVEN_NATS = float(np.log((1.0 - _WRONG_SHARE) / _WRONG_SHARE))
"""What must speak for another place until it is as probable as the one that a search has chosen: 2.9 nats."""
SETTLED_NATS = float(np.log(1e3))
"""Where every other place is so much less probable, masks have settled it, whatever satellites say: the risk that
levels are made for."""
_BELIEFS = SensorBeliefs()


def nats_against(pose: FusedPose, fixes: Fixes) -> float:
    """Returns what it costs to believe the calibration that a track needs to stand where it is [nats]."""
    scale = (pose.odometer_scale - 1.0) / _BELIEFS.scale_sigma
    return 0.5 * (_offset_sigmas(pose, fixes) ** 2 + scale**2)


def nats_of_tracks(poses: Sequence[FusedPose], num_accepted: Sequence[int], fixes: Fixes) -> list[float]:
    """Returns `nats_against` of poses of one vehicle at one time.

    The satellites are off by one amount, and the track that was followed longest has learned it: that tells what a
    younger one needs, which knows nothing yet and would be free of what fixes say.

    Args:
        poses: What the tracks say.
        num_accepted: How many frames each has taken.
        fixes: The last fixes.
    """
    oldest = int(np.argmax(num_accepted))
    at = poses[oldest].gnss_offset_m + poses[oldest].T_map_base[:2, 3]
    told = [pose._replace(gnss_offset_m=at - pose.T_map_base[:2, 3]) for pose in poses]
    is_younger = [num < num_accepted[oldest] for num in num_accepted]
    return [nats_against(told[k] if is_younger[k] else poses[k], fixes) for k in range(len(poses))]


def needs_doubtful_sensors(pose: FusedPose, fixes: Fixes) -> bool:
    """Returns whether the pose needs a calibration that is hardly to be believed."""
    return nats_against(pose, fixes) >= EVEN_NATS


def doubts(pose: FusedPose, fixes: Fixes, nats_elsewhere: float) -> tuple[str, ...]:
    """Returns a sentence where the calibration is hardly to be believed, and what it points to.

    Args:
        pose: Fused.
        fixes: The last fixes.
        nats_elsewhere: By how much every other place is less probable by this frame and the fixes together.
    """
    if not needs_doubtful_sensors(pose, fixes):
        return ()
    if nats_elsewhere >= SETTLED_NATS and may_be_settled(pose, fixes):
        return ()
    off_m = float(np.hypot(*pose.gnss_offset_m))
    return (
        f"the pose needs satellites that are {off_m:.1f} m off and an odometer scale of {pose.odometer_scale:.3f}: "
        "it may be a period of the markings away",
    )


def may_be_settled(pose: FusedPose, fixes: Fixes) -> bool:
    """Returns whether masks can tell that satellites are wrong: aside they can, along the way they cannot.

    Masks that are shown late, or early, fit a place behind or ahead as well as the right ones fit the right place.
    """
    forward = pose.T_map_base[:2, 0] / np.linalg.norm(pose.T_map_base[:2, 0])
    along = pose._replace(gnss_offset_m=forward * (forward @ pose.gnss_offset_m), odometer_scale=1.0)
    return nats_against(along, fixes) < EVEN_NATS


def _offset_sigmas(pose: FusedPose, fixes: Fixes) -> float:
    """Returns how far the satellites are believed to be off, in standard deviations of their slow error."""
    there = np.isfinite(fixes.time_s)
    if not there.any():
        return 0.0
    stated_m = float(np.median(np.max(fixes.sigma_m[there, :2], axis=1)))
    return float(np.hypot(*pose.gnss_offset_m)) / max(_SIGMA_INFLATION * stated_m, _LEAST_SIGMA_M)
