"""The verdict on a frame: how far its pose may be trusted, and why not farther (room: localization; host).

In: TrackerState after a frame, what the frame measured, the fused pose. Out: FrameVerdict.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import Rig
from semloc_jax.evaluation.held import held_text
from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.localization import health, phase, pose_levels
from semloc_jax.localization.following import FrameReport
from semloc_jax.localization.integrity import ProtectionLevels, beyond_alert
from semloc_jax.localization.separation import STAY
from semloc_jax.localization.track_config import TrackConfig
from semloc_jax.localization.track_state import TrackerState, TrackStatus

_NO_LEVELS = ProtectionLevels(np.inf, np.inf, np.inf)


class FrameVerdict(NamedTuple):
    """What is said of a frame."""

    status: TrackStatus
    reasons: tuple[str, ...]
    protection: ProtectionLevels
    doubted: Float[np.ndarray, "2 3"]
    """Where the right pose might be of late, see `TrackerState`."""
    held: tuple[str, ...] = ()
    misleading: float = 1.0
    move: Float[np.ndarray, "3"] = STAY
    """How far the pose that goes out is moved, see `PoseLevels`."""
    left_open: Float[np.ndarray, "3"] = STAY
    """Variance that faults add to that of the pose, see `PoseLevels`."""


def judged(
    state: TrackerState,
    view: FrameReport | None,
    fused: FusedPose | None,
    rig: Rig,
    way_m: float,
    map_sigma: tuple[float, float],
    config: TrackConfig,
    why_no_start: Callable[[], str],
) -> FrameVerdict:
    """The verdict on a frame.

    Args:
        state: After the frame.
        view: What the frame said about the best track; None where none was followed.
        fused: The pose in the map; None before there is any.
        rig: Cameras.
        way_m: Way since the frame before [m].
        map_sigma: What the map leaves open around the pose: place [m], direction [rad].
        config: Limits.
        why_no_start: Why the vehicle was not found.
    """
    reasons = view.reasons if view is not None else ()
    if fused is None:
        return FrameVerdict(TrackStatus.INITIALIZING, (f"no pose yet: {why_no_start()}",), _NO_LEVELS, state.doubted)
    known = pose_levels.known_of(state, fused, rig, way_m, map_sigma, config)
    levels, limit = pose_levels.levels_of(known), known.limit
    protection = levels.protection
    if not state.tracks:
        lost = health.lost_because(state.counters, config.health)
        return FrameVerdict(TrackStatus.LOST, lost + reasons, protection, state.doubted)
    against = _contradictions(state, reasons, config.health)
    elsewhere = phase.doubts(fused, state.fixes, float(state.elsewhere.nats))
    is_confirmed = bool(state.tracks[0].num_accepted >= config.confirm_frames)
    status_with = partial(health.status_of, len(state.tracks), is_confirmed)
    if beyond_alert(protection, limit) and status_with((*against, *elsewhere)) == TrackStatus.TRACKING:
        levels = pose_levels.within(known, levels)  # what masks say is not touched for nothing
        protection = levels.protection
    serious = (*beyond_alert(protection, limit), *against, *elsewhere)
    status = status_with(serious)
    held = ()
    if status != TrackStatus.INITIALIZING and not against:
        held = health.held_of(protection, limit, bool(elsewhere))
    told = filter(None, [held_text(protection, held)])
    all_told = tuple(dict.fromkeys((*levels.causes, *serious, *reasons, *told)))
    far = levels.misleading, levels.move, levels.left_open
    return FrameVerdict(status, all_told, protection, known.doubted, held, *far)


def _contradictions(state: TrackerState, reasons: tuple[str, ...], config: health.HealthConfig) -> tuple[str, ...]:
    """What speaks against the pose as a whole: frames, satellites, the end of the map."""
    best, conflicts = state.tracks[0], float(state.counters.conflicts)
    # A fix or a frame may be wrong; a fix and a frame that speak against the pose at once hardly are.
    is_doubted = conflicts > 1 or (conflicts > 0 and best.num_refused > 0)
    if not (best.num_refused > config.max_refused or is_doubted or state.counters.off_map > 0):
        return ()
    return reasons or (
        f"{conflicts:.0f} satellite fixes contradict the pose" if conflicts else "frames before contradict it",
    )
