"""Other places along the road that explain a frame better than a track does (room: localization; host).

In: a track, one frame, satellite fixes. Out: tracks that begin at such places.
Dashes repeat: a track a period off, or half of one, follows the road as well as the right one, and no solve leaves its
valley. So a frame is held against the map at all places within reach of the satellites, and where one fits clearly
better, it is followed beside the track until frames, odometry and fixes have decided.
"""

from dataclasses import dataclass

import numpy as np

from semloc_jax.alignment.same_pose import ONE_TRACK, units_apart
from semloc_jax.fusion.measurements import Fusion
from semloc_jax.geometry import rigid
from semloc_jax.localization import phase
from semloc_jax.localization.beginning import cautious, new_track
from semloc_jax.localization.following import FrameReport
from semloc_jax.localization.frame_in_map import FrameInMap
from semloc_jax.localization.track_state import Fixes, Track, TrackerState


@dataclass(frozen=True)
class RivalConfig:
    """Where other places are looked for, and which count. All values are ours."""

    every_s: float = 0.5
    reach_m: float = 14.0
    """To both sides: a period of dashes is 6 to 18 m, and fixes are metres off."""
    step_m: float = 0.25
    apart_m: float = 1.0
    """Nearer to the track than this is the track itself."""
    most: int = 2
    max_tracks: int = 4
    """While as many tracks are followed, no more are begun."""


_CONFIG = RivalConfig()


def joined(state: TrackerState, view: FrameReport | None, frame: FrameInMap, fusion: Fusion) -> TrackerState:
    """Returns the state with tracks at other places along the road, where it is time to look for them.

    Args:
        state: After the frame.
        view: What the frame said about the best track.
        frame: The frame.
        fusion: What tracks are made of.
    """
    too_early = state.time_s < state.searched_s + _CONFIG.every_s - 1e-6
    if too_early or view is None or not view.is_accepted or len(state.tracks) >= _CONFIG.max_tracks:
        return state
    kept = list(state.tracks)
    for rival in rivals(kept[0], view.found.score, state.fixes, fusion, frame):
        T = fusion.pose(rival.fusion).T_map_base
        if all(units_apart(T, fusion.pose(track.fusion).T_map_base) >= ONE_TRACK for track in kept):
            kept.append(rival)
    return state._replace(tracks=tuple(kept), searched_s=state.time_s)


def rivals(track: Track, score: float, fixes: Fixes, fusion: Fusion, frame: FrameInMap) -> list[Track]:
    """Returns a track for each place along the road that explains the frame clearly better; best first.

    Args:
        track: The track, at the time of the frame.
        score: Cost of the frame there [nats].
        fixes: The last satellite fixes: what they are off by at either place counts, too.
        fusion: What tracks are made of.
        frame: The frame.
    """
    pose = fusion.pose(track.fusion)
    T = pose.T_map_base
    num = round(_CONFIG.reach_m / _CONFIG.step_m)
    offsets = _CONFIG.step_m * np.arange(-num, num + 1)
    costs = frame.costs_beside(T, offsets[:, None] * np.array([1.0, 0.0, 0.0]))
    if costs is None:
        return []
    found = []
    for offset_m in offsets[_valleys(costs, offsets)][: _CONFIG.most]:
        moved = T @ rigid.exp(np.array([offset_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
        spread = np.diag([0.5, 0.1, 0.05, 0.01, 0.01, 0.01]) ** 2
        answer = frame.explained_from(moved, spread, _CONFIG.step_m)
        if answer is None:
            continue
        moved_m = (answer.measurement.T_map_base - T)[:2, 3]
        there = pose._replace(gnss_offset_m=pose.gnss_offset_m - moved_m)
        for_fixes = phase.nats_against(pose, fixes) - phase.nats_against(there, fixes)
        gain = score - answer.score + for_fixes
        away_m = np.hypot(*moved_m)
        if gain < phase.EVEN_NATS or away_m < _CONFIG.apart_m:
            continue
        covariance = cautious(answer.measurement.covariance)
        # It begins as probable as the track; as this one frame is forgotten, others must pay for what fixes say.
        penalty = float(track.penalty) + for_fixes
        found.append((gain, new_track(fusion, answer.measurement._replace(covariance=covariance), penalty)))
    return [rival for _, rival in sorted(found, key=lambda pair: -pair[0])]


def _valleys(costs: np.ndarray, offsets_m: np.ndarray) -> np.ndarray:
    """Returns the indices of the local minima away from the middle, lowest first."""
    lower = np.r_[True, costs[1:] < costs[:-1]] & np.r_[costs[:-1] <= costs[1:], True]
    index = np.flatnonzero(lower & (np.abs(offsets_m) > _CONFIG.apart_m) & np.isfinite(costs))
    return index[np.argsort(costs[index])]
