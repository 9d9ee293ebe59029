"""What a frame whose pose was taken says of the clock and of the errors of measured poses (room: localization; host).

In: TrackerState after the frame, the motion since the last pose. Out: the state that has learned it.
"""

from semloc_jax.fusion import clock, noise_scale
from semloc_jax.fusion.clock import CameraTimeLog
from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.localization.following import FrameReport
from semloc_jax.localization.track_state import TrackerState


def with_learned(
    state: TrackerState, view: FrameReport, fused: FusedPose, motion: CameraTimeLog, before: FusedPose, way_m: float
) -> TrackerState:
    """The state with what a frame says of clock and noise.

    Args:
        state: After the frame.
        view: What it measured.
        fused: The pose after it.
        motion: The log.
        before: The pose at the frame before.
        way_m: Way since the frame before [m].
    """
    now_s, before_s = float(state.time_s), before.time_s
    slope = motion.slope(before_s, now_s, moving=before.moving)
    offset = clock.learned(state.clock, slope, view.difference, view.covariance, now_s - before_s, clock.BELIEFS)
    taken_s = max(noise_scale.last_taken_s(state.noise), before_s)
    step = motion.increment(taken_s, now_s, fused.calibration, before.moving)
    noise = noise_scale.learned(state.noise, view.found.measurement, fused, step, way_m, noise_scale.BELIEFS)
    return state._replace(noise=noise, clock=offset)
