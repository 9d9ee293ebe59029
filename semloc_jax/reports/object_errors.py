"""Errors of things that are followed against a true map and true poses (room: reports; host).

In: sights of single frames and tracks, frame by frame. Out: metrics along the axes of the vehicle: single frames, the
plain Kalman filter and the fused tracks, searching and parking apart; how many tracks are of nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Drive, Frame
from semloc_jax.evaluation import Metric
from semloc_jax.mapping.object_tracks import ObjectSight, ObjectTrack

SAME_M = 1.0
"""What is farther off is none of the true things."""
_NEAR_M, _LOOKS = 5.0, 5
"""A thing ought to be found that was so near in so many frames, hidden or not."""
_SLOW_MPS = 1.0
WAYS = ("single", "kalman", "fused")


@dataclass(frozen=True)
class TrueThings:
    """What a map says is there.

    Attributes:
        poses: `float64[n 3]` place [m] and direction [rad] in the map.
        kinds: of each; "" where any kind will do.
        same_rad: a thing turned by more is another one; None where the direction does not count.
    """

    poses: Float[np.ndarray, "n 3"]
    kinds: tuple[str, ...]
    same_rad: float | None = None

    def nearest(
        self, pose: Float[np.ndarray, " 3"], true_base: Float[np.ndarray, "n 3"], kind: str
    ) -> tuple[int, Float[np.ndarray, " 3"]] | None:
        """Index of the true thing that a pose is, both in the base frame, and how far off it is; None for none."""
        if not len(true_base):
            return None
        off = pose - true_base
        off[:, 2] = (off[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        may_be = np.array([own in ("", kind) for own in self.kinds])
        if self.same_rad is not None:
            may_be &= np.abs(off[:, 2]) < self.same_rad
        away = np.where(may_be, np.linalg.norm(off[:, :2], axis=1), np.inf)
        k = int(away.argmin())
        return (k, off[k]) if away[k] < SAME_M else None


class ObjectErrors:
    """Collects the errors of a run; says nothing where no truth is known."""

    def __init__(self, drive: Drive | None, things: TrueThings):
        """The true things; without a drive nothing is said."""
        self.drive = drive if len(things.poses) else None
        self.things = things
        self.rows: list[tuple[str, bool, np.ndarray]] = []
        self.num_false = dict.fromkeys(WAYS, 0)
        self.num_near = np.zeros(len(things.poses), int)
        self.num_switches = 0
        self._followed: dict[int, int] = {}

    def add(
        self,
        frame: Frame,
        T_odom_base: np.ndarray,
        sights: Sequence[ObjectSight],
        tracks: Sequence[ObjectTrack | None],
        slow: bool,
    ) -> None:
        """The sights of one frame and the tracks that took them; tracks count once they are confirmed."""
        if self.drive is None:
            return
        true_base = in_base(self.things.poses, self.drive.truth_at(frame))
        self.num_near += np.linalg.norm(true_base[:, :2], axis=1) < _NEAR_M
        for sight, track in zip(sights, tracks, strict=True):
            poses = {"single": sight.pose}
            if track is not None and track.confirmed:
                poses |= {"kalman": track.kalman, "fused": track.pose}
            for way, pose in poses.items():
                found = self.things.nearest(in_base(pose[None], T_odom_base)[0], true_base, sight.kind)
                if found is None:
                    self.num_false[way] += 1
                    continue
                self.rows.append((way, slow, found[1]))
                if way == "fused":
                    self.num_switches += self._followed.setdefault(found[0], track.id) != track.id
                    self._followed[found[0]] = track.id

    def metrics(self, final: Sequence[ObjectTrack], Ts_odom_base: Mapping[int, np.ndarray]) -> list[Metric]:
        """Mean absolute errors along x and y of the vehicle, and how many tracks are of nothing.

        Args:
            final: the final tracks.
            Ts_odom_base: pose at the last sight of each, by id.
        """
        if self.drive is None:
            return []
        found = []
        for way in WAYS:
            for phase, slow in (("searching", False), ("parking", True)):
                off = np.array([row[2] for row in self.rows if row[0] == way and row[1] == slow]).reshape(-1, 3)
                if len(off):
                    found += self._phase(f"{phase}.{way}", off)
        found += [Metric(f"false.{way}", float(self.num_false[way]), "sights") for way in WAYS]
        found.append(Metric("switches", float(self.num_switches), "sights"))
        return found + self._final(final, Ts_odom_base)

    def _phase(self, key: str, off: np.ndarray) -> list[Metric]:
        mean = np.abs(off).mean(axis=0)
        found = [Metric(f"{key}.{axis}", float(100.0 * mean[k]), "cm") for k, axis in enumerate("xy")]
        if self.things.same_rad is not None:
            found.append(Metric(f"{key}.yaw", float(np.rad2deg(mean[2])), "deg"))
        return [*found, Metric(f"{key}.num", float(len(off)), "sights", "report")]

    def _final(self, final: Sequence[ObjectTrack], Ts_odom_base: Mapping[int, np.ndarray]) -> list[Metric]:
        offs, taken, pairs = [], [], []
        for track in final:
            T_map_base = self.drive.truth.interpolate(np.array([track.last_s]))[0]
            pose = in_base(track.pose[None], Ts_odom_base[track.id])[0]
            found = self.things.nearest(pose, in_base(self.things.poses, T_map_base), track.kind)
            if found is not None:
                taken.append(found[0])
                offs.append(found[1])
                pairs.append((track, found[0]))
        said = [Metric("final.false", float(len(final) - len(offs)), "tracks")]
        said.append(Metric("final.twice", float(len(taken) - len(set(taken))), "tracks"))
        near = np.flatnonzero(self.num_near >= _LOOKS)
        if len(near):
            said.append(Metric("final.recall_near", float(np.isin(near, taken).mean()), "share", "higher"))
        if offs:
            mean = np.abs(np.array(offs)).mean(axis=0)
            said += [Metric(f"final.{axis}", float(100.0 * mean[k]), "cm") for k, axis in enumerate("xy")]
        return said + self.final_more(pairs)

    def final_more(self, pairs: Sequence[tuple[ObjectTrack, int]]) -> list[Metric]:
        """What else is said of final tracks and the true things that they are."""
        return []


def is_slow(drive: Drive, frame: Frame) -> bool:
    """Whether the vehicle is parking, by its odometry, and not searching."""
    return abs(float(np.interp(frame.time_s, drive.odometry.time_s, drive.odometry.speed_mps))) < _SLOW_MPS


def in_base(poses: np.ndarray, T_world_base: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Poses of a world in the axes of the vehicle."""
    R = T_world_base[:2, :2]
    xy = (poses[:, :2] - T_world_base[:2, 3]) @ R
    return np.column_stack([xy, poses[:, 2] - np.arctan2(R[1, 0], R[0, 0])])


def last_poses(
    tracks: Sequence[ObjectTrack], drive: Drive, Ts_odom_base: Float[np.ndarray, "n 4 4"]
) -> dict[int, Float[np.ndarray, "4 4"]]:
    """T_odom_base of the frame in which each track was seen last, by its id."""
    index_at = {round(frame.time_s, 6): index for index, frame in enumerate(drive.frames)}
    return {track.id: Ts_odom_base[index_at[round(track.last_s, 6)]] for track in tracks}
