"""Whether masks speak against the place that satellites ask for (room: localization; host).

In: a track that contradicts the satellites, one frame. Out: how many nats the best other place is behind.
A pose that is a period of dashes or a lane off fits every frame, and only satellites tell. Where the map holds more
than that, arrows, posts, crossings, the masks themselves say that the other place is wrong: then the satellites are.
"""

import numpy as np
from jaxtyping import Float

from semloc_jax.errors import SemlocError
from semloc_jax.fusion.measurements import FusedPose, Fusion
from semloc_jax.geometry import rigid
from semloc_jax.localization import health, phase
from semloc_jax.localization.following import FrameReport
from semloc_jax.localization.frame_alignment import Alignment, FrameAligner
from semloc_jax.localization.health import HealthConfig
from semloc_jax.localization.rivals import Known
from semloc_jax.localization.track_state import Fixes, FrameFeatures, TrackerState

_EVERY_S = 0.5
"""As often as other places along the road are looked for."""
_FARTHEST_M = (20.0, 8.0)
"""Satellites that ask for a place farther ahead or aside are not settled: the longest period of dashes is 18 m,
two lanes are 7.5 m."""
_BEYOND_M = (8.0, 4.0)
"""How far beyond both places others are looked at, along and across the road: a short period, a lane. Ours."""
_STEP_M = (0.5, 0.25)
_APART_M = 1.0
"""Nearer than this is the pose itself."""
_MOST = 3
"""Places that are solved."""
_SHARE = 0.5
"""Factor on the cost between two places [nats], as between the starts of one solve: it overstates which is right."""
_SPREAD = np.diag([0.5, 0.3, 0.05, 0.01, 0.01, 0.02]) ** 2
"""How far a place may move when it is solved: a step of the search, and a bend of the road."""


def with_nats_elsewhere(
    state: TrackerState,
    view: FrameReport | None,
    frame: FrameFeatures,
    known: Known,
    fusion: Fusion,
    aligner: FrameAligner,
    config: HealthConfig,
) -> TrackerState:
    """The state with how many nats every other place is behind, where satellites contradict the pose and it is time.

    Args:
        state: After the frame.
        view: What the frame said about the best track.
        frame: The frame.
        known: What is known beside the pose.
        fusion: What tracks are made of.
        aligner: The map.
        config: When a frame shows nothing.
    """
    if len(state.tracks) != 1 or view is None or not view.is_accepted:
        return state
    pose = fusion.pose(state.tracks[0].fusion)
    if not phase.needs_doubtful_sensors(pose, state.fixes):
        return state._replace(elsewhere=state.elsewhere._replace(nats=np.float64(0.0), time_s=np.float64(-np.inf)))
    if frame.time_s < state.elsewhere.time_s + _EVERY_S - 1e-6:
        return state
    try:
        nats = _behind(pose, view.found, state.fixes, frame, known, aligner, config)
    except SemlocError:  # no road there
        return state
    return state._replace(elsewhere=state.elsewhere._replace(nats=np.float64(nats), time_s=np.float64(frame.time_s)))


def _behind(
    pose: FusedPose,
    found: Alignment,
    fixes: Fixes,
    frame: FrameFeatures,
    known: Known,
    aligner: FrameAligner,
    config: HealthConfig,
) -> float:
    """By how much the best of all other places is less probable than the pose [nats]: 0 where they are too far away,
    infinite where none fits."""
    T, here = pose.T_map_base, phase.nats_against(pose, fixes)
    asked_m = T[:2, :2].T @ pose.gnss_offset_m
    if (np.abs(asked_m) > _FARTHEST_M).any():
        return 0.0
    moves = places(asked_m)
    costs = aligner.costs_beside(frame, T, moves, *known)
    against = np.array([phase.nats_against(_at(pose, move), fixes) for move in moves]) - here
    total = np.where(np.isfinite(costs), _SHARE * costs + against, np.inf)
    best = np.inf
    for row in _apart(moves, total):
        moved = T @ rigid.exp(np.array([*moves[row, :2], 0.0, 0.0, 0.0, 0.0]))
        try:
            answer = aligner.align(frame, moved, _SPREAD, _STEP_M[0], *known)
        except SemlocError:
            continue
        is_occluded, reasons = health.frame_problems(answer, frame.usable_share, config)
        there = (rigid.inverse(T) @ answer.measurement.T_map_base)[:2, 3]
        if is_occluded or reasons or float(np.hypot(*there)) < _APART_M:
            continue
        against_there = phase.nats_against(_at(pose, np.array([*there, 0.0])), fixes) - here
        best = min(best, _SHARE * (answer.score - found.score) + against_there)
    return best


def places(asked_m: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n 3"]:
    """Moves (forward [m], left [m], turned [rad]) along and across the road, through the pose and through the place
    that is so far ahead and left of it; their number is always the same."""
    along, across = (
        np.linspace(min(to, 0.0) - beyond, max(to, 0.0) + beyond, 1 + round((farthest + 2.0 * beyond) / step))
        for to, farthest, beyond, step in zip(asked_m, _FARTHEST_M, _BEYOND_M, _STEP_M, strict=True)
    )
    rows = [(x, y) for y in (0.0, asked_m[1]) for x in along] + [(x, y) for x in (0.0, asked_m[0]) for y in across]
    return np.column_stack([np.array(rows), np.zeros(len(rows))])


def _apart(moves: np.ndarray, total: np.ndarray) -> list[int]:
    """The best places that are apart from the pose and from each other."""
    kept: list[int] = []
    for row in np.argsort(total, kind="stable"):
        others = [np.zeros(2), *(moves[k, :2] for k in kept)]
        if np.isfinite(total[row]) and all(np.hypot(*(moves[row, :2] - other)) >= _APART_M for other in others):
            kept.append(int(row))
        if len(kept) == _MOST:
            break
    return kept


def _at(pose: FusedPose, move: np.ndarray) -> FusedPose:
    """The pose moved along the ground: the satellites are off by so much less there."""
    moved_m = pose.T_map_base[:2, :2] @ move[:2]
    return pose._replace(gnss_offset_m=pose.gnss_offset_m - moved_m)
