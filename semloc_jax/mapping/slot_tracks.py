"""Parking slots over many frames: birth, association, existence, fusion (room: mapping; host).

In: the slots of each frame in odom. Out: tracks, each one slot with pose, size, occupancy and existence; beside it a
plain Kalman filter per track as the baseline.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment

from semloc_jax.mapping.slot_sights import Slot

_FAR = 1e6


@dataclass(frozen=True)
class SlotTrackConfig:
    """How slots are followed.

    Args:
        gate: largest squared Mahalanobis distance of x and y: chi-square of two degrees of freedom at 99 %.
        gate_m: largest distance, whatever the covariances say: less than half an entrance.
        same_deg: directions of one slot differ by no more.
        confirm: sights in the first frames of a track from which it counts, and how many frames.
        forget: visible misses on end after which a track ends.
        detected, false: share of the visible looks that show a slot, and of those at none that do; for the existence.
        drift_share: error of the odometry by way driven: older sights count less for where the slot is now.
        outlier_sigmas: width of Cauchy's kernel.
        calibrated: sights of one slot agree better than pixel, pitch and height by themselves: their common error
            moves with the car. Factor on the covariance within a track.
        kalman_m: noise of a sight that the baseline assumes, the same at every range.
        kalman_walk_m: what the baseline lets a slot move from frame to frame.
    """

    gate: float = 9.21
    gate_m: float = 1.0
    same_deg: float = 15.0
    confirm: tuple[int, int] = (3, 5)
    forget: int = 5
    detected: float = 0.7
    false: float = 0.1
    drift_share: float = 0.02
    outlier_sigmas: float = 1.5
    calibrated: float = 0.25
    kalman_m: float = 0.1
    kalman_walk_m: float = 0.01


@dataclass
class SlotTrack:
    """One slot that is followed.

    Attributes:
        id: number of the track.
        pose, covariance: fused, in odom: middle of the entrance [m] and direction into the slot [rad].
        kalman: the same by the plain filter, `float64[3]`.
        existence_logit: log odds that it is there.
        num_seen, num_missed: frames that showed it, and that looked and did not.
        confirmed: whether it was seen often enough in its first frames.
        last_s: when it was seen last.
    """

    id: int
    pose: Float[np.ndarray, " 3"]
    covariance: Float[np.ndarray, "3 3"]
    kalman: Float[np.ndarray, " 3"]
    existence_logit: float = 0.0
    num_seen: int = 0
    num_missed: int = 0
    misses_on_end: int = 0
    confirmed: bool = False
    last_s: float = 0.0
    born: list[bool] = field(default_factory=list)
    sights: list[tuple[Slot, float]] = field(default_factory=list)
    kalman_variance: float = 1.0

    @property
    def kind(self) -> str:
        """The type that most sights state."""
        kinds = [slot.kind for slot, _ in self.sights]
        return max(set(kinds), key=kinds.count)

    @property
    def width_m(self) -> float:
        """Median of the sights."""
        return float(np.median([slot.width_m for slot, _ in self.sights]))

    @property
    def depth_m(self) -> float:
        """Median of the sights."""
        return float(np.median([slot.depth_m for slot, _ in self.sights]))

    @property
    def occupied(self) -> bool | None:
        """What most of the last sights say, those into the slot where there are any; None where none could see."""
        known = [slot for slot, _ in self.sights if slot.occupied is not None]
        said = [slot.occupied for slot in ([slot for slot in known if slot.is_faced] or known)[-9:]]
        return None if not said else sum(said) * 2 > len(said)

    @property
    def existence(self) -> float:
        """Probability that it is there."""
        return float(0.5 * (1.0 + np.tanh(0.5 * self.existence_logit)))

    def corners(self) -> Float[np.ndarray, "2 2"]:
        """Both ends of the entrance in odom [m]."""
        along = np.array([np.sin(self.pose[2]), -np.cos(self.pose[2])])
        return self.pose[:2] + 0.5 * self.width_m * np.array([along, -along])


class SlotTracker:
    """Follows the slots of a drive in odom."""

    def __init__(self, config: SlotTrackConfig | None = None):
        self.config = config or SlotTrackConfig()
        self.tracks: list[SlotTrack] = []
        self.ended: list[SlotTrack] = []
        self._count = 0

    def step(
        self, slots: Sequence[Slot], time_s: float, way_m: float, visible: Bool[np.ndarray, " n"]
    ) -> list[SlotTrack | None]:
        """Take one frame in; returns the track of each of its slots.

        Args:
            slots: of the frame, in odom.
            time_s: of the frame.
            way_m: driven so far; the odometry drifts with it.
            visible: whether each track's entrance could be seen, in the order of `tracks`.
        """
        pairs = associated(self.tracks, slots, self.config)
        for number, track in enumerate(self.tracks):
            self._count_look(track, number in pairs, bool(visible[number]))
        found: list[SlotTrack | None] = [None] * len(slots)
        for number, k in pairs.items():
            self._take(self.tracks[number], slots[k], time_s, way_m)
            found[k] = self.tracks[number]
        for k, slot in enumerate(slots):
            if found[k] is None:
                found[k] = self._birth(slot, time_s, way_m)
        over = [t for t in self.tracks if t.misses_on_end >= self.config.forget or self._is_stillborn(t)]
        self.ended += [t for t in over if t.confirmed and t.misses_on_end < self.config.forget]
        self.tracks = [t for t in self.tracks if t not in over]
        return found

    def final(self) -> list[SlotTrack]:
        """Confirmed tracks that were not denied."""
        return [t for t in [*self.ended, *self.tracks] if t.confirmed]

    def _is_stillborn(self, track: SlotTrack) -> bool:
        return not track.confirmed and len(track.born) >= self.config.confirm[1]

    def _count_look(self, track: SlotTrack, seen: bool, visible: bool) -> None:
        if not (seen or visible):
            return
        if not track.confirmed and len(track.born) < self.config.confirm[1]:
            track.born.append(seen)
            track.confirmed = sum(track.born) >= self.config.confirm[0]
        told = (self.config.detected, self.config.false) if seen else (1 - self.config.detected, 1 - self.config.false)
        track.existence_logit = float(np.clip(track.existence_logit + np.log(told[0] / told[1]), -8.0, 8.0))
        track.num_seen += seen
        track.num_missed += not seen
        track.misses_on_end = 0 if seen else track.misses_on_end + 1

    def _birth(self, slot: Slot, time_s: float, way_m: float) -> SlotTrack:
        track = SlotTrack(self._count, slot.pose.copy(), slot.covariance.copy(), slot.pose.copy())
        track.kalman_variance = self.config.kalman_m**2
        self._count += 1
        self._count_look(track, True, True)
        track.sights.append((slot, way_m))
        track.last_s = time_s
        self.tracks.append(track)
        return track

    def _take(self, track: SlotTrack, slot: Slot, time_s: float, way_m: float) -> None:
        track.sights.append((slot, way_m))
        track.last_s = time_s
        track.pose, track.covariance = fused(track.sights, way_m, self.config)
        # The baseline: constant noise, a slot that may walk.
        predicted = track.kalman_variance + self.config.kalman_walk_m**2
        gain = predicted / (predicted + self.config.kalman_m**2)
        off = slot.pose - track.kalman
        off[2] = _wrapped(off[2])
        track.kalman = track.kalman + gain * off
        track.kalman_variance = (1.0 - gain) * predicted


def associated(tracks: Sequence[SlotTrack], slots: Sequence[Slot], config: SlotTrackConfig) -> dict[int, int]:
    """Which slot of a frame each track is: one to one, by squared Mahalanobis distance within the gate."""
    if not tracks or not slots:
        return {}
    cost = np.full((len(tracks), len(slots)), _FAR)
    for i, track in enumerate(tracks):
        for j, slot in enumerate(slots):
            off = slot.pose - track.pose
            if np.hypot(*off[:2]) > config.gate_m or abs(_wrapped(off[2])) > np.deg2rad(config.same_deg):
                continue
            if (slot.kind == "parallel") != (track.kind == "parallel"):
                continue
            S = track.covariance[:2, :2] + slot.covariance[:2, :2]
            squared = float(off[:2] @ np.linalg.solve(S, off[:2]))
            if squared < config.gate:
                cost[i, j] = squared
    rows, columns = linear_sum_assignment(cost)
    return {int(i): int(j) for i, j in zip(rows, columns, strict=True) if cost[i, j] < _FAR}


def fused(
    sights: Sequence[tuple[Slot, float]], way_m: float, config: SlotTrackConfig
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """The pose that all sights of a slot say together, with Cauchy's kernel, and its covariance.

    What a camera knows of a place falls with the range; what a sight says of the slot's place relative to the vehicle
    now falls with the way driven since, by which the odometry drifts.
    """
    poses = np.stack([slot.pose for slot, _ in sights])
    poses[:, 2] = poses[-1, 2] + (poses[:, 2] - poses[-1, 2] + np.pi) % (2.0 * np.pi) - np.pi
    information = []
    for slot, driven_m in sights:
        drift = config.drift_share * abs(way_m - driven_m)
        C = config.calibrated * slot.covariance + np.diag([drift**2, drift**2, 0.0])
        information.append(np.linalg.inv(C))
    information = np.stack(information)
    pose = np.median(poses, axis=0) if len(poses) > 2 else poses.mean(axis=0)
    for _ in range(6):
        off = poses - pose
        squared = np.einsum("ni,nij,nj->n", off, information, off)
        weight = 1.0 / (1.0 + squared / (3.0 * config.outlier_sigmas**2))
        total = np.einsum("n,nij->ij", weight, information)
        pose = np.linalg.solve(total, np.einsum("n,nij,nj->i", weight, information, poses))
    # Errors of mounts and road are the same in neighbouring frames: so many sights say no more than their root.
    return pose, np.linalg.inv(total) * np.sqrt(len(sights)) / config.calibrated


def _wrapped(angle_rad: float) -> float:
    return float((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)
