"""The verdict on a frame: how far its pose may be trusted, and why not farther (room: localization; host).

In: TrackerState after a frame, what the frame measured, the fused pose. Out: FrameVerdict.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.evaluation.held import held_text
from semloc_jax.fusion import noise_scale
from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.localization import course, health, innovations, phase, watch
from semloc_jax.localization.following import FrameReport
from semloc_jax.localization.integrity import (
    ProtectionLevels,
    beyond_alert,
    map_sigmas,
    misleading,
    protection_levels,
)
from semloc_jax.localization.track_config import TrackConfig
from semloc_jax.localization.track_state import TrackerState, TrackStatus

_AS_LEVELS = [1, 0, 2]
"""Lateral, longitudinal, heading among the directions of `noise_scale`."""
_NO_LEVELS = ProtectionLevels(np.inf, np.inf, np.inf)


class FrameVerdict(NamedTuple):
    """What is said of a frame."""

    status: TrackStatus
    reasons: tuple[str, ...]
    protection: ProtectionLevels
    held: tuple[str, ...] = ()
    misleading: float = 1.0


def judged(
    state: TrackerState,
    view: FrameReport | None,
    fused: FusedPose | None,
    rig: Rig,
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
        map_sigma: What the map leaves open around the pose: place [m], direction [rad].
        config: Limits.
        why_no_start: Why the vehicle was not found.
    """
    reasons = view.reasons if view is not None else ()
    if fused is None:
        return FrameVerdict(TrackStatus.INITIALIZING, (f"no pose yet: {why_no_start()}",), _NO_LEVELS)
    levels = levels_of(state, fused, rig, map_sigma, config)
    protection = levels.protection
    if not state.tracks:
        return FrameVerdict(TrackStatus.LOST, health.lost_because(state.counters, config.health) + reasons, protection)
    limit = config.health.integrity.limit
    beyond, against = beyond_alert(protection, limit), _contradictions(state, reasons, config.health)
    elsewhere = phase.doubts(fused, state.fixes, float(state.elsewhere.nats))
    serious = (*beyond, *against, *elsewhere)
    is_confirmed = bool(state.tracks[0].num_accepted >= config.confirm_frames)
    status = health.status_of(len(state.tracks), is_confirmed, serious)
    held = ()
    if status != TrackStatus.INITIALIZING and not against:
        held = health.held_of(protection, limit, bool(elsewhere))
    told = filter(None, [held_text(protection, held)])
    all_told = tuple(dict.fromkeys((*levels.causes, *serious, *reasons, *told)))
    return FrameVerdict(status, all_told, protection, held, levels.misleading)


class PoseLevels(NamedTuple):
    """Protection levels of a pose under every suspected fault.

    Attributes:
        protection: The levels.
        causes: A sentence for each fault that takes one beyond its alert limit.
        misleading: Probability that an error is beyond its alert limit.
    """

    protection: ProtectionLevels
    causes: tuple[str, ...]
    misleading: float


def spoken_for(state: TrackerState, rig: Rig, config: TrackConfig) -> list[watch.Separation]:
    """What the last frames say against calibration, map and motion."""
    doubts = (watch.Separation(*doubt) for doubt in innovations.doubts(state.innovations))
    return [*doubts, *watch.spoken_for(state.watch, rig, config.watch)]


def _faults(state: TrackerState, rig: Rig, config: TrackConfig) -> list[watch.Separation]:
    """Every fault that a level has to hold under."""
    spoken = spoken_for(state, rig, config)
    lasting = watch.lasting(state.doubted, spoken)
    return [*spoken, *lasting, *watch.separations(state.watch, rig, config.watch)]


def levels_of(
    state: TrackerState, fused: FusedPose, rig: Rig, map_sigma: tuple[float, float], config: TrackConfig
) -> PoseLevels:
    """The levels of a pose; arguments as `judged`."""
    integrity, limit = config.health.integrity, config.health.integrity.limit
    freedom = noise_scale.freedom(state.noise, noise_scale.BELIEFS)[_AS_LEVELS]
    known = fused.covariance, freedom, map_sigmas(*map_sigma)
    faults = _faults(state, rig, config) if state.tracks else []
    farthest = np.max([np.zeros(3), *(np.array(fault[:3]) for fault in faults)], axis=0)
    room = np.array(watch.room_in(limit, config.watch)) - farthest
    levels = protection_levels(*known, room, integrity)
    if not state.tracks:
        return PoseLevels(watch.at_least(levels, config.watch), (), misleading(*known, farthest, limit))
    misled = misleading(*known, farthest, limit)
    protection = watch.at_least(watch.with_faults(levels, faults), config.watch)
    # Cameras that look aside: the pose with the heading of its course may be the right one instead.
    way, aside_rad = course.course_of(fused), float(state.watch.aside_rad)
    probable = course.probability(aside_rad, way, watch.is_ahead(rig))
    aside_deg = course.heading_level_deg(aside_rad, way, float(freedom[2]), integrity.risk / 6.0 / probable)
    causes = watch.causes(levels, faults, limit)
    if protection.heading_deg <= limit.heading_deg < aside_deg:
        causes = (*causes, watch.aside_cause(way, aside_rad, aside_deg, rig))
    misled += probable * course.misleading(aside_rad, way, float(freedom[2]), limit.heading_deg)
    aside_m = abs(way.off_rad) * watch.cameras_ahead_m(rig)
    protection = protection._replace(
        lateral_m=max(protection.lateral_m, levels.lateral_m + aside_m),
        heading_deg=max(protection.heading_deg, aside_deg),
    )
    return PoseLevels(protection, causes, min(misled, 1.0))


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
