"""Poses of the last frames with the landmarks they share: a map that is known to centimetres only (room: fusion; host
around JAX).

In: matches of each frame, motion between frames. Out: LastPose: pose and covariance of the last frame.
A landmark that the map has wrong is wrong in every frame that sees it: its shift is a variable of the window. Taken as
new in each frame it would make the stated covariance too small.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.explicit.factors import KINDS, On, row_of
from semloc_jax.alignment.explicit.landmarks import Landmark
from semloc_jax.alignment.explicit.pairs import Match
from semloc_jax.alignment.explicit.prediction import AssociationConfig
from semloc_jax.residuals.motion import between_linearised, between_residual, pose_linearised, pose_residual
from semloc_jax.residuals.seen_point import shift_residual
from semloc_jax.solvers.factors import POSE, Factors, vector
from semloc_jax.solvers.front import Dense, solve, structured
from semloc_jax.solvers.graph import FactorGraph, Family, Values
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.structs import SolveStatus

_SHIFT = vector(0.05, 0.05, 0.05)
_SOLVE = SolveConfig(tolerance=1e-4, max_steps=15)
_UNUSED = 1e3
"""Square root of the information that holds a frame where it is that is not there yet."""


class WindowFrame(NamedTuple):
    """One frame of the window."""

    matches: tuple[Match, ...]
    T_local_base: Float[np.ndarray, "4 4"]
    """Where a solve begins."""
    T_before_base: Float[np.ndarray, "4 4"]
    """Motion since the frame before, as it was measured."""
    motion_sqrt_info: Float[np.ndarray, "6 6"]
    T_prior: Float[np.ndarray, "4 4"]
    """Where the vehicle stands by the road of the map and by satellites."""
    prior_sqrt_info: Float[np.ndarray, "6 6"]


class LastPose(NamedTuple):
    """The last pose of a window."""

    T_local_base: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    status: SolveStatus


@dataclass(frozen=True)
class WindowSize:
    """Fixed sizes, so that one program serves a drive."""

    num_frames: int = 12
    num_landmarks: int = 64
    """Shifts; of more landmarks the first ones are used."""
    rows_per_frame: int = 10
    """Factors of each kind, on average over the frames."""


def last_pose(
    frames: Sequence[WindowFrame], landmarks: Sequence[Landmark], config: AssociationConfig, size: WindowSize
) -> LastPose:
    """The last pose of some frames.

    Args:
        frames: Oldest first; the last ones where there are too many.
        landmarks: What the matches name, in the local frame.
        config: How sure the map is: `map_sigma_m` of each landmark, in every direction.
        size: Of the program.
    """
    graph, start = _window(frames, landmarks, config, size, is_robust=True)
    with jax.enable_x64(True):
        T, covariance, status = jax.tree.map(np.asarray, _solved(graph, start))
    return LastPose(T, covariance, SolveStatus(int(status)))


def bound_of(
    frames: Sequence[WindowFrame], landmarks: Sequence[Landmark], config: AssociationConfig, size: WindowSize
) -> Float[np.ndarray, "6 6"]:
    """Least covariance of the last pose (Cramer, Rao): inverse information at the given poses, all else unknown.

    Arguments as `last_pose`, but with the true poses, the true map and where it was seen without noise.
    """
    graph, start = _window(frames, landmarks, config, size, is_robust=False)
    with jax.enable_x64(True):
        return np.asarray(_least(graph, start))


@eqx.filter_jit
def _solved(graph: FactorGraph, start: Values):
    found = solve(graph, start, _SOLVE)
    return found.value["pose"][-1], found.equations.covariance(_last(graph)), found.status


@eqx.filter_jit
def _least(graph: FactorGraph, start: Values):
    return structured(graph, Dense()).linearise(start, jnp.zeros((), bool)).covariance(_last(graph))


def _last(graph: FactorGraph) -> np.ndarray:
    return POSE.size * (graph.family("pose").num - 1) + np.arange(POSE.size)


def _window(
    frames: Sequence[WindowFrame],
    landmarks: Sequence[Landmark],
    config: AssociationConfig,
    size: WindowSize,
    is_robust: bool,
) -> tuple[FactorGraph, Values]:
    """Poses and shifts with all that is known of them, and where a solve begins."""
    filled = _filled(frames[-size.num_frames :], size.num_frames)
    names = dict.fromkeys(match.landmark for frame in reversed(filled) for match in frame.matches)
    place = {name: k for k, name in enumerate(list(names)[: size.num_landmarks])}
    rows: dict[str, list[On]] = {name: [] for name in KINDS}
    exact = replace(config, map_sigma_m=0.0)  # the errors of the map are variables
    for pose in reversed(range(size.num_frames)):  # the newest first, where there are too many
        for match in filled[pose].matches:
            if match.landmark in place:
                name, row = row_of(match, landmarks[match.landmark], filled[pose].T_local_base, exact)
                rows[name].append(On(row, pose, place[match.landmark]))
    num = size.num_frames * size.rows_per_frame
    seen = [kind.factors(rows[name], num, True, is_robust) for name, kind in KINDS.items()]
    shifts = np.arange(size.num_landmarks)
    held = np.full((size.num_landmarks, 3), 1.0 / config.map_sigma_m)
    of_map = Factors(shift_residual, ("shift",), (shifts,), (), held)
    families = Family("pose", POSE, size.num_frames), Family("shift", _SHIFT, size.num_landmarks)
    graph = FactorGraph(families, (*seen, of_map, *_of_poses(filled)))
    start = {
        "pose": np.stack([frame.T_local_base for frame in filled]),
        "shift": np.zeros((size.num_landmarks, 3)),
    }
    return graph, start


def _filled(frames: Sequence[WindowFrame], num: int) -> list[WindowFrame]:
    """The frames at the end of so many; those before them saw nothing and are held where the first one is."""
    first = frames[0]
    unused = WindowFrame((), first.T_local_base, np.eye(4), np.zeros((6, 6)), first.T_local_base, _UNUSED * np.eye(6))
    begin = first._replace(motion_sqrt_info=np.zeros((6, 6)))
    return [*[unused] * (num - len(frames)), begin, *frames[1:]]


def _of_poses(frames: Sequence[WindowFrame]) -> tuple[Factors, Factors]:
    """Motion between frames, and what is known of each without masks."""
    later = np.arange(1, len(frames))
    motion = Factors(
        between_residual,
        ("pose", "pose"),
        (later - 1, later),
        (np.stack([frame.T_before_base for frame in frames[1:]]),),
        np.stack([frame.motion_sqrt_info for frame in frames[1:]]),
        linearised=between_linearised,
    )
    prior = Factors(
        pose_residual,
        ("pose",),
        (np.arange(len(frames)),),
        (np.stack([frame.T_prior for frame in frames]),),
        np.stack([frame.prior_sqrt_info for frame in frames]),
        linearised=pose_linearised,
    )
    return motion, prior
