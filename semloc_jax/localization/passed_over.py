"""Frames of a stream that cannot follow the one before (room: localization; host).

In: the state and a frame. Out: why the frame is passed over, and the result that says so. It costs itself only.
"""

import numpy as np

from semloc_jax.localization.track_state import FrameFeatures, TrackerState, TrackResult, TrackStatus


def because(state: TrackerState, frame: FrameFeatures) -> str | None:
    """Why a frame cannot follow the state; None where it can."""
    if not np.isfinite(frame.time_s):
        return f"the frame has the time {frame.time_s}"
    if frame.time_s <= state.time_s:
        return f"the frame of {frame.time_s:.3f} s comes after that of {float(state.time_s):.3f} s"
    return None


def result(state: TrackerState, frame: FrameFeatures, reason: str) -> TrackResult:
    """The result of a frame that was not looked at: never TRACKING, since it has no pose."""
    status = TrackStatus(int(state.status))
    status = TrackStatus.DEGRADED if status == TrackStatus.TRACKING else status
    return TrackResult(frame.frame_id, frame.time_s, status, (reason,), num_tracks=len(state.tracks))
