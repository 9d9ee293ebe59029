"""Tracks carried on to the time of a frame, by motion and by the fixes on the way (room: localization; host).

In: TrackerState, FrameFeatures, the motion log. Out: the state at the time of the frame.
"""

from collections.abc import Sequence
from typing import Any, SupportsInt

import numpy as np

from semloc_jax.fusion.clock import CameraTimeLog
from semloc_jax.fusion.measurements import FusedPose, Fusion, GnssMeasurement, Innovation
from semloc_jax.localization.health import HealthConfig
from semloc_jax.localization.initialization import with_fix
from semloc_jax.localization.track_state import FrameFeatures, TrackerState


def predicted(
    state: TrackerState, frame: FrameFeatures, fusion: Fusion, motion: CameraTimeLog, config: HealthConfig
) -> TrackerState:
    """Every track at the time of the frame, with the fixes on the way."""
    tracks, counters = [], state.counters
    for rank, track in enumerate(state.tracks):
        carried_on, fitted = carried(track.fusion, fusion, motion, frame.fixes, frame.time_s)
        for term in frame.terms:
            carried_on, _ = fusion.correct_term(carried_on, term)
        tracks.append(track._replace(fusion=carried_on))
        if rank == 0:
            counters = counters._replace(conflicts=conflicts_after(counters.conflicts, fitted, config))
    coasting = tuple(carried(c, fusion, motion, (), frame.time_s)[0] for c in state.coasting)
    fixes = state.fixes
    for fix in frame.fixes:
        fixes = with_fix(fixes, fix)
    return state._replace(
        time_s=np.float64(frame.time_s),
        tracks=tuple(tracks),
        coasting=coasting,
        fixes=fixes,
        counters=counters,
        digest=np.uint32(frame.digest),
    )


def carried(
    state: Any, fusion: Fusion, motion: CameraTimeLog, fixes: Sequence[GnssMeasurement], to_s: float
) -> tuple[Any, list[tuple[GnssMeasurement, Innovation, FusedPose]]]:
    """The state of a fusion at a later time, and how each fix on the way fitted the pose before it.

    Fixes that come too late for their time are left out.
    """
    fitted = []
    for fix in sorted(fixes, key=lambda fix: fix.time_s):
        if not float(fusion.pose(state).time_s) <= fix.time_s <= to_s:
            continue
        state = _moved(state, fusion, motion, fix.time_s)
        before = fusion.pose(state)
        state, innovation = fusion.correct_gnss(state, fix)
        fitted.append((fix, innovation, before))
    return _moved(state, fusion, motion, to_s), fitted


def _moved(state: Any, fusion: Fusion, motion: CameraTimeLog, to_s: float) -> Any:
    pose = fusion.pose(state)
    if to_s <= pose.time_s:
        return state
    return fusion.predict(state, motion.increment(pose.time_s, to_s, pose.calibration, pose.moving))


def way_since(
    before_s: float, before: FusedPose | None, state: TrackerState, fusion: Fusion, motion: CameraTimeLog
) -> float:
    """Way since the frame before [m]: by the wheels, or as the best track was predicted where velocity is estimated.

    Args:
        before_s: Time of that frame; -inf where there was none.
        before: Pose of the best track then.
        state: Predicted to the time of this frame.
        fusion: Of the tracks.
        motion: The log.
    """
    if before is not None and before.moving is not None:
        off = fusion.pose(state.tracks[0].fusion).T_map_base - before.T_map_base
        return float(np.linalg.norm(off[:3, 3]))
    return motion.way_m(before_s, float(state.time_s)) if np.isfinite(before_s) else 0.0


def conflicts_after(
    conflicts: SupportsInt, fitted: Sequence[tuple[GnssMeasurement, Innovation, FusedPose]], config: HealthConfig
) -> np.int64:
    """Number of fixes in a row that contradict the pose, after some more of them."""
    in_a_row = int(conflicts)
    for fix, innovation, pose in fitted:
        off_m = float(np.hypot(*(fix.p_map - pose.T_map_base[:3, 3])[:2]))
        sigma_m = float(np.hypot(np.max(fix.sigma_m[:2]), np.sqrt(np.max(np.diagonal(pose.covariance)[:2]))))
        is_conflict = not innovation.accepted and off_m > max(config.conflict_m, 5.0 * sigma_m)
        in_a_row = in_a_row + 1 if is_conflict else 0
    return np.int64(in_a_row)
