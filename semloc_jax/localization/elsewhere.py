"""Whether masks speak against the place that satellites ask for (room: localization; host).

In: a track that contradicts the satellites, one frame. Out: how many nats the best other place is behind.
A pose that is a period of dashes or a lane off fits every frame, and only satellites tell. Where the map holds more
than that, arrows, posts, crossings, the masks themselves say that the other place is wrong: then the satellites are.
Along the way that holds only as far as masks are of the time that they state (`phase.may_be_settled`).
"""

import numpy as np
from jaxtyping import Float

from semloc_jax.fusion.measurements import FusedPose, Fusion
from semloc_jax.geometry import rigid
from semloc_jax.localization import phase
from semloc_jax.localization.following import FrameReport
from semloc_jax.localization.frame_alignment import Alignment
from semloc_jax.localization.frame_in_map import FrameInMap
from semloc_jax.localization.track_state import Elsewhere, Fixes, TrackerState

_EVERY_S = 0.5
"""As often as other places along the road are looked for."""
_REACH_M = (10.0, 8.0)
"""How far places along and across the road are looked at, around the pose and around the place that satellites ask for:
a period of dashes, two lanes. Ours."""
_STEP_M = (0.5, 0.25)
_APART_M = 1.0
"""Nearer than this is the pose itself."""
_MOST = 2
"""Places around each of both that are solved."""
_SHARE = 0.5
"""Factor on the cost between two places [nats], as between the starts of one solve: it overstates which is right."""
_SPREAD = np.diag([0.5, 0.3, 0.05, 0.01, 0.01, 0.03]) ** 2
"""How far a place may move when it is solved: a step of the search, and a bend of the road."""


def with_nats_elsewhere(
    state: TrackerState, view: FrameReport | None, frame: FrameInMap, fusion: Fusion
) -> TrackerState:
    """The state with how many nats every other place is behind, where satellites contradict the pose and it is time.

    Args:
        state: After the frame.
        view: What the frame said about the best track.
        frame: The frame.
        fusion: What tracks are made of.
    """
    if len(state.tracks) != 1 or view is None or not view.is_accepted:
        return state
    pose = fusion.pose(state.tracks[0].fusion)
    is_contradicted = int(state.counters.conflicts) > 0
    if not is_contradicted and not phase.needs_doubtful_sensors(pose, state.fixes):
        return state._replace(elsewhere=Elsewhere())
    if is_contradicted:  # fixes that were refused: the offset of the satellites has not followed them
        pose = pose._replace(gnss_offset_m=state.fixes.p_map[-1, :2] - pose.T_map_base[:2, 3])
    elif state.time_s < state.elsewhere.time_s + _EVERY_S - 1e-6:
        return state
    nats = _behind(pose, view.found, state.fixes, frame)
    state = state._replace(elsewhere=Elsewhere(np.float64(nats), state.time_s))
    if is_contradicted and nats >= phase.SETTLED_NATS and phase.may_be_settled(pose, state.fixes):
        state = state._replace(counters=state.counters._replace(conflicts=np.int64(0)))
    return state


def _behind(pose: FusedPose, found: Alignment, fixes: Fixes, frame: FrameInMap) -> float:
    """By how much the best of all other places is less probable than the pose [nats]; infinite where none fits."""
    T, here = pose.T_map_base, phase.nats_against(pose, fixes)
    asked = T.copy()
    asked[:2, 3] += pose.gnss_offset_m
    best = np.inf
    for start in _starts(T, asked, frame):
        answer = frame.explained_from(start, _SPREAD, _STEP_M[0])
        if answer is None:
            continue
        moved_m = (answer.measurement.T_map_base - T)[:2, 3]
        if float(np.hypot(*moved_m)) < _APART_M:
            continue
        there = phase.nats_against(pose._replace(gnss_offset_m=pose.gnss_offset_m - moved_m), fixes)
        best = min(best, _SHARE * (answer.score - found.score) + there - here)
    return best


def _starts(T_here: np.ndarray, T_asked: np.ndarray, frame: FrameInMap) -> list[np.ndarray]:
    """Poses to solve from: the place that is asked for, and the best ones around it and around the pose."""
    starts, moves = [T_asked], crossing()
    for T in (T_here, T_asked):
        costs = frame.costs_beside(T, moves)
        if costs is None:
            continue
        for row in _apart(moves, costs):
            starts.append(T @ rigid.exp(np.array([*moves[row, :2], 0.0, 0.0, 0.0, 0.0])))
    return starts


def crossing() -> Float[np.ndarray, "n 3"]:
    """Moves (forward [m], left [m], turned [rad]) along and across the road."""
    along, across = (
        np.linspace(-reach, reach, 1 + 2 * round(reach / step)) for reach, step in zip(_REACH_M, _STEP_M, strict=True)
    )
    rows = [(x, 0.0, 0.0) for x in along] + [(0.0, y, 0.0) for y in across]
    return np.array(rows)


def _apart(moves: np.ndarray, costs: np.ndarray) -> list[int]:
    """The cheapest moves that are apart from none and from each other."""
    kept: list[int] = []
    for row in np.argsort(costs, kind="stable"):
        others = [np.zeros(2), *(moves[k, :2] for k in kept)]
        if np.isfinite(costs[row]) and all(np.hypot(*(moves[row, :2] - other)) >= _APART_M for other in others):
            kept.append(int(row))
        if len(kept) == _MOST:
            break
    return kept
