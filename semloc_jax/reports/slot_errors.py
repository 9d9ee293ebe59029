"""Errors of slots against a true map and true poses, in the axes of the vehicle (room: reports; host).

In: slots of single frames and of tracks, frame by frame. Out: metrics of single frames, of the plain Kalman filter and
of the fused tracks, searching and parking apart.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from semloc_jax.datasets import Drive, Frame
from semloc_jax.evaluation import Metric
from semloc_jax.mapping.slot_sights import Slot
from semloc_jax.mapping.slot_tracks import SlotTrack
from semloc_jax.maps import read_map
from semloc_jax.structs import ElementClass

_SAME_M, _SAME_RAD = 1.0, 0.35
"""A slot farther off, or turned more, is none of the true ones."""
_NEAR_M, _LOOKS = 5.0, 5
"""A slot ought to be found whose entrance was so near in so many frames, hidden or not."""
WAYS = ("single", "kalman", "fused")


class SlotErrors:
    """Collects the errors of a run; says nothing where no truth is known."""

    def __init__(self, drive: Drive | None, true_poses: np.ndarray, taken: Sequence[bool | None] = ()):
        """The true slots, float64[n 3]: middle of the entrance [m] and direction into the slot in the map; whether a
        vehicle stands in each, None where the map does not say."""
        self.drive, self.true_poses, self.taken = drive, true_poses, tuple(taken)
        self.rows: list[tuple[str, bool, np.ndarray]] = []
        self.num_false = dict.fromkeys(WAYS, 0)
        self.num_near = np.zeros(len(true_poses), int)

    @classmethod
    def of(cls, drive: Drive) -> "SlotErrors":
        """The true slots of a drive, where it has a map and true poses."""
        if drive.truth is None or drive.map_path is None:
            return cls(None, np.zeros((0, 3)))
        slots = [e for e in read_map(drive.map_path).elements if e.label == ElementClass.PARKING_SLOT]
        found, taken = [], [e.attributes.get("occupied") for e in slots]
        for corners in (e.points[:4, :2] for e in slots):
            inward = 0.5 * (corners[3] - corners[0] + corners[2] - corners[1])
            found.append([*(0.5 * (corners[0] + corners[1])), np.arctan2(inward[1], inward[0])])
        return cls(drive if found else None, np.array(found).reshape(-1, 3), taken)

    def add(
        self,
        frame: Frame,
        T_odom_base: np.ndarray,
        slots: Sequence[Slot],
        tracks: Sequence[SlotTrack | None],
        slow: bool,
    ) -> None:
        """The slots of one frame and the tracks that took them; tracks count once they are confirmed."""
        if self.drive is None:
            return
        true_base = _in_base(self.true_poses, self.drive.truth_at(frame))
        self.num_near += np.linalg.norm(true_base[:, :2], axis=1) < _NEAR_M
        for slot, track in zip(slots, tracks, strict=True):
            poses = {"single": slot.pose}
            if track is not None and track.confirmed:
                poses |= {"kalman": track.kalman, "fused": track.pose}
            for way, pose in poses.items():
                off = _nearest(_in_base(pose[None], T_odom_base)[0], true_base)
                if off is None:
                    self.num_false[way] += 1
                else:
                    self.rows.append((way, slow, off))

    def metrics(self, final: Sequence[SlotTrack], Ts_odom_base: Mapping[int, np.ndarray]) -> list[Metric]:
        """Mean absolute errors along x and y of the vehicle, and how many slots are none.

        Args:
            final: the final tracks.
            Ts_odom_base: pose at the last sight of each, by id.
        """
        found = []
        for way in WAYS:
            for phase, slow in (("searching", False), ("parking", True)):
                off = np.array([row[2] for row in self.rows if row[0] == way and row[1] == slow]).reshape(-1, 3)
                if len(off):
                    mean = np.abs(off).mean(axis=0)
                    found.append(Metric(f"{phase}.{way}.x", float(100.0 * mean[0]), "cm"))
                    found.append(Metric(f"{phase}.{way}.y", float(100.0 * mean[1]), "cm"))
                    found.append(Metric(f"{phase}.{way}.yaw", float(np.rad2deg(mean[2])), "deg"))
                    found.append(Metric(f"{phase}.{way}.num", float(len(off)), "slots", "report"))
        if self.drive is not None:
            found += [Metric(f"false.{way}", float(self.num_false[way]), "slots") for way in WAYS]
            found += self._final(final, Ts_odom_base)
        return found

    def _final(self, final: Sequence[SlotTrack], Ts_odom_base: Mapping[int, np.ndarray]) -> list[Metric]:
        offs, taken, right = [], [], []
        for track in final:
            T_map_base = self.drive.truth.interpolate(np.array([track.last_s]))[0]
            true_base = _in_base(self.true_poses, T_map_base)
            pose = _in_base(track.pose[None], Ts_odom_base[track.id])[0]
            off = _nearest(pose, true_base)
            if off is not None:
                offs.append(off)
                taken.append(int(np.linalg.norm(true_base[:, :2] - pose[:2], axis=1).argmin()))
                if track.occupied is not None and self.taken[taken[-1]] is not None:
                    right.append(bool(track.occupied) == bool(self.taken[taken[-1]]))
        found = [Metric("final.false", float(len(final) - len(offs)), "slots")]
        found.append(Metric("final.twice", float(len(taken) - len(set(taken))), "slots"))
        near = np.flatnonzero(self.num_near >= _LOOKS)
        if len(near):
            found.append(Metric("final.recall_near", float(np.isin(near, taken).mean()), "share", "higher"))
        if right:
            found.append(Metric("final.occupancy_right", float(np.mean(right)), "share", "higher"))
        if offs:
            mean = np.abs(np.array(offs)).mean(axis=0)
            found += [Metric("final.x", float(100 * mean[0]), "cm"), Metric("final.y", float(100 * mean[1]), "cm")]
        return found


def _in_base(poses: np.ndarray, T_map_base: np.ndarray) -> np.ndarray:
    R = T_map_base[:2, :2]
    xy = (poses[:, :2] - T_map_base[:2, 3]) @ R
    return np.column_stack([xy, poses[:, 2] - np.arctan2(R[1, 0], R[0, 0])])


def _nearest(pose: np.ndarray, others: np.ndarray) -> np.ndarray | None:
    """Pose less the nearest of others that points the same way; None where none is near."""
    off = pose - others
    off[:, 2] = (off[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    away = np.where(np.abs(off[:, 2]) < _SAME_RAD, np.linalg.norm(off[:, :2], axis=1), np.inf)
    k = int(away.argmin())
    return off[k] if away[k] < _SAME_M else None
