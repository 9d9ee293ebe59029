"""The tree of coordinate frames in a bag (room: datasets; host).

In: transforms of /tf and /tf_static. Out: constant extrinsics and the path of the vehicle in the map.
"""

import logging
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.geometry.rigid import pose_from

_LOG = logging.getLogger(__name__)
BASE_FRAMES = ("base_link", "base_footprint", "rear_axle", "ego_vehicle", "base", "body", "vehicle")
MAP_FRAMES = ("map", "world", "earth")
_STILL_M, _STILL_RAD = 0.02, 0.005
_MAX_KEPT = 1_000_000


class FrameTree:
    """Frames by their parents: T_parent_child at the times at which it was sent."""

    def __init__(self) -> None:
        self._edges: dict[tuple[str, str], list[tuple[float, np.ndarray]]] = {}

    def add(self, time_s: float, parent: str, child: str, translation: Any, rotation: Any) -> None:
        """T_parent_child at a time, of a geometry_msgs Vector3 or Point and a Quaternion."""
        edge, t, q = (clean(parent), clean(child)), translation, rotation
        kept = self._edges.setdefault(edge, [])
        if len(kept) < _MAX_KEPT:
            kept.append((time_s, motion([t.x, t.y, t.z], [q.x, q.y, q.z, q.w], f"tf {edge[0]} -> {edge[1]}")))

    def __contains__(self, frame: str) -> bool:
        return any(frame in edge for edge in self._edges)

    @property
    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        return sorted({frame for edge in self._edges for frame in edge})

    def first_of(self, names: Iterable[str]) -> str | None:
        """The first of the names that is a frame of the tree."""
        return next((name for name in names if name in self), None)

    def constant(self, parent: str, child: str) -> np.ndarray | None:
        """T_parent_child [4 4] of frames that do not move against each other; None where nothing links them.

        A warning tells of links that do move; their first transform is taken.
        """
        chain = self._chain(parent, child)
        if chain is None:
            return None
        T = np.eye(4)
        for edge, is_forward in chain:
            kept = self._edges[edge]
            if len(kept) > 1 and _moves(kept[0][1], kept[-1][1]):
                _LOG.warning("tf %s -> %s changes over time; its first value is taken", *edge)
            T = T @ (kept[0][1] if is_forward else np.linalg.inv(kept[0][1]))
        return T

    def path(self, parent: str, child: str) -> Trajectory | None:
        """T_parent_child over time, at the times of the link that was sent most often; None without a moving link."""
        chain = self._chain(parent, child)
        if not chain:
            return None
        tracks = {edge: _track(self._edges[edge]) for edge, _ in chain}
        busiest = max(tracks.values(), key=len)
        if len(busiest) < 2:
            return None
        moving = [track for track in tracks.values() if len(track) > 1]
        first, last = max(t.time_s[0] for t in moving), min(t.time_s[-1] for t in moving)
        time_s = busiest.time_s[(busiest.time_s >= first) & (busiest.time_s <= last)]
        if len(time_s) < 2:
            return None
        T = np.tile(np.eye(4), (len(time_s), 1, 1))
        for edge, is_forward in chain:
            track = tracks[edge]
            step = track.interpolate(time_s) if len(track) > 1 else np.repeat(track.T_map_base, len(time_s), axis=0)
            T = T @ (step if is_forward else np.linalg.inv(step))
        return Trajectory(time_s, T)

    def _chain(self, parent: str, child: str) -> list[tuple[tuple[str, str], bool]] | None:
        """Links from parent to child, each with whether it is walked from its parent to its child."""
        if parent == child:
            return []
        came_from: dict[str, tuple[str, tuple[str, str], bool]] = {parent: ("", ("", ""), True)}
        waiting = deque([parent])
        while waiting:
            here = waiting.popleft()
            for edge in self._edges:
                if here not in edge:
                    continue
                is_forward = edge[0] == here
                there = edge[1] if is_forward else edge[0]
                if there not in came_from:
                    came_from[there] = (here, edge, is_forward)
                    waiting.append(there)
        if child not in came_from:
            return None
        chain, here = [], child
        while here != parent:
            before, edge, is_forward = came_from[here]
            chain.append((edge, is_forward))
            here = before
        return chain[::-1]


def clean(frame: str) -> str:
    """Name of a frame without the slash that ROS 1 puts before it."""
    return frame.lstrip("/")


def motion(translation: list[float], quaternion_xyzw: list[float], where: str) -> np.ndarray:
    """Rigid motion [4 4] of a translation and a quaternion.

    Raises:
        SemlocError: a number is not finite, or the quaternion has no length.
    """
    values = np.array([*translation, *quaternion_xyzw], dtype=np.float64)
    if not np.isfinite(values).all() or np.linalg.norm(values[3:]) < 1e-6:
        raise SemlocError(f"{where}: transform {values.tolist()}; expected finite numbers and a unit quaternion")
    return pose_from(Rotation.from_quat(values[3:]).as_matrix(), values[:3])


def _moves(a: np.ndarray, b: np.ndarray) -> bool:
    turn = np.arccos(np.clip(0.5 * (np.trace(a[:3, :3].T @ b[:3, :3]) - 1.0), -1.0, 1.0))
    return bool(np.linalg.norm(a[:3, 3] - b[:3, 3]) > _STILL_M or turn > _STILL_RAD)


def _track(kept: list[tuple[float, np.ndarray]]) -> Trajectory:
    time_s = np.array([time for time, _ in kept])
    _, order = np.unique(time_s, return_index=True)
    return Trajectory(time_s[order], np.stack([kept[i][1] for i in order]))
