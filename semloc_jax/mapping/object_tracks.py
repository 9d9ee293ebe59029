"""Things around a vehicle over many frames: birth, association, existence, fusion (room: mapping; host).

In: sights of each frame in odom. Out: tracks, each one thing with pose and existence; beside it a plain Kalman filter
per track as the baseline. What a thing is (a slot, an obstacle) says the subclass of ObjectTrack.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment

_FAR = 1e6
_ROUNDS = 6


@runtime_checkable
class ObjectSight(Protocol):
    """One thing as seen in one frame."""

    @property
    def pose(self) -> Float[np.ndarray, " 3"]:
        """x, y [m] and direction [rad] in odom."""

    @property
    def covariance(self) -> Float[np.ndarray, "3 3"]:
        """Of the pose."""

    @property
    def by_height(self) -> Float[np.ndarray, " 3"]:
        """How the pose moves where the road there is one sigma higher than thought; part of the covariance."""


@dataclass(frozen=True)
class ObjectTrackConfig:
    """How things are followed.

    Args:
        gate: largest squared Mahalanobis distance of x and y: chi-square of two degrees of freedom at 99 %.
        gate_m: largest distance, whatever the covariances say: less than half an entrance of a slot.
        same_deg: directions of one slot differ by no more.
        confirm: sights in the first frames of a track from which it counts, and how many frames.
        forget: visible misses on end after which a track ends.
        detected, false: share of the visible looks that show a thing, and of those at none that do; for the existence.
        drift_share: error of the odometry by way driven: older sights count less for where the thing is now.
        outlier_sigmas: width of Cauchy's loss.
        calibrated: sights of one thing agree better than pixel, pitch and height by themselves: their common error
            moves with the car. Factor on the covariance within a track.
        kalman_m: noise of a sight that the baseline assumes, the same at every range.
        kalman_walk_m: what the baseline lets a thing move from frame to frame.
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
class ObjectTrack:
    """One thing that is followed.

    Attributes:
        id: number of the track.
        pose, covariance: fused, in odom: place [m] and direction [rad].
        kalman: the same by the plain filter, `float64[3]`.
        existence_logit: log odds that it is there.
        num_seen, num_missed: frames that showed it, and that looked and did not.
        confirmed: whether it was seen often enough in its first frames, and is placed.
        last_s: when it was seen last.
        sights: what was seen of it, and the way driven until then [m].
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
    sights: list[tuple[Any, float]] = field(default_factory=list)
    kalman_variance: float = 1.0

    @property
    def existence(self) -> float:
        """Probability that it is there."""
        return float(0.5 * (1.0 + np.tanh(0.5 * self.existence_logit)))

    def may_be(self, sight: Any, config: ObjectTrackConfig) -> bool:
        """Whether a sight is one of such a thing at all, wherever it is."""
        raise NotImplementedError

    def is_placed(self) -> bool:
        """Whether its sights tell where it is; before that it cannot be confirmed."""
        return True

    def excludes(self, other: Any) -> bool:
        """Whether another track cannot be a second thing beside this one, since both would stand in one place."""
        return False


AnyTrack = TypeVar("AnyTrack", bound=ObjectTrack)


class Tracker(Generic[AnyTrack]):
    """Follows the things of a drive in odom."""

    def __init__(self, make: Callable[..., AnyTrack], config: ObjectTrackConfig | None = None):
        """Nothing is followed yet; `make` is the class of its tracks."""
        self.config = config or ObjectTrackConfig()
        self.tracks: list[AnyTrack] = []
        self.ended: list[AnyTrack] = []
        self._make, self._count = make, 0

    def step(
        self, sights: Sequence[ObjectSight], time_s: float, way_m: float, visible: Bool[np.ndarray, " n"]
    ) -> list[AnyTrack | None]:
        """Take one frame in; returns the track of each of its sights.

        Args:
            sights: of the frame, in odom.
            time_s: of the frame.
            way_m: driven so far; the odometry drifts with it.
            visible: whether each track could be seen, in the order of `tracks`.
        """
        pairs = associated(self.tracks, sights, self.config)
        for number, track in enumerate(self.tracks):
            self._count_look(track, number in pairs, bool(visible[number]))
        found: list[AnyTrack | None] = [None] * len(sights)
        for number, k in pairs.items():
            self._take(self.tracks[number], sights[k], time_s, way_m)
            found[k] = self.tracks[number]
        for k, sight in enumerate(sights):
            if found[k] is None:
                found[k] = self._birth(sight, time_s, way_m)
        for track in self.tracks:
            track.confirmed = track.confirmed or (self._is_born(track) and track.is_placed())
        over = [t for t in self.tracks if t.misses_on_end >= self.config.forget or self._is_stillborn(t)]
        self.ended += [t for t in over if t.confirmed and t.misses_on_end < self.config.forget]
        self.tracks = [t for t in self.tracks if t not in over]
        return found

    def final(self) -> list[AnyTrack]:
        """Confirmed tracks that were not denied; of those in one place the one that was seen most."""
        found = [t for t in [*self.ended, *self.tracks] if t.confirmed]
        kept: list[AnyTrack] = []
        for track in sorted(found, key=lambda t: -t.num_seen):
            if not any(other.excludes(track) for other in kept):
                kept.append(track)
        return [track for track in found if track in kept]

    def _is_born(self, track: AnyTrack) -> bool:
        return sum(track.born) >= self.config.confirm[0]

    def _is_stillborn(self, track: AnyTrack) -> bool:
        return len(track.born) >= self.config.confirm[1] and not self._is_born(track)

    def _count_look(self, track: AnyTrack, seen: bool, visible: bool) -> None:
        if not (seen or visible):
            return
        if not track.confirmed and len(track.born) < self.config.confirm[1]:
            track.born.append(seen)
        told = (self.config.detected, self.config.false) if seen else (1 - self.config.detected, 1 - self.config.false)
        track.existence_logit = float(np.clip(track.existence_logit + np.log(told[0] / told[1]), -8.0, 8.0))
        track.num_seen += seen
        track.num_missed += not seen
        track.misses_on_end = 0 if seen else track.misses_on_end + 1

    def _birth(self, sight: ObjectSight, time_s: float, way_m: float) -> AnyTrack:
        track = self._make(self._count, sight.pose.copy(), sight.covariance.copy(), sight.pose.copy())
        track.kalman_variance = self.config.kalman_m**2
        self._count += 1
        self._count_look(track, True, True)
        track.sights.append((sight, way_m))
        track.last_s = time_s
        self.tracks.append(track)
        return track

    def _take(self, track: AnyTrack, sight: ObjectSight, time_s: float, way_m: float) -> None:
        track.sights.append((sight, way_m))
        track.last_s = time_s
        track.pose, track.covariance = fused(track.sights, way_m, self.config)
        # The baseline: constant noise, a thing that may walk.
        predicted = track.kalman_variance + self.config.kalman_walk_m**2
        gain = predicted / (predicted + self.config.kalman_m**2)
        off = sight.pose - track.kalman
        off[2] = wrapped(off[2])
        track.kalman = track.kalman + gain * off
        track.kalman_variance = (1.0 - gain) * predicted


def associated(
    tracks: Sequence[ObjectTrack], sights: Sequence[ObjectSight], config: ObjectTrackConfig
) -> dict[int, int]:
    """Which sight of a frame each track is: one to one, by squared Mahalanobis distance within the gate."""
    if not tracks or not sights:
        return {}
    cost = np.full((len(tracks), len(sights)), _FAR)
    for i, track in enumerate(tracks):
        for j, sight in enumerate(sights):
            off = (sight.pose - track.pose)[:2]
            if np.hypot(*off) > config.gate_m or not track.may_be(sight, config):
                continue
            S = track.covariance[:2, :2] + sight.covariance[:2, :2]
            squared = float(off @ np.linalg.solve(S, off))
            if squared < config.gate:
                cost[i, j] = squared
    rows, columns = linear_sum_assignment(cost)
    return {int(i): int(j) for i, j in zip(rows, columns, strict=True) if cost[i, j] < _FAR}


def fused(
    sights: Sequence[tuple[ObjectSight, float]], way_m: float, config: ObjectTrackConfig
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """The pose that all sights of a thing say together, with Cauchy's loss, and its covariance.

    What a camera knows of a place falls with the range; what a sight says of the thing's place relative to the vehicle
    now falls with the way driven since, by which the odometry drifts. The road below a thing has one height, whoever
    looks: how far it is off the road that is assumed is one more unknown.
    """
    poses = np.stack([sight.pose for sight, _ in sights])
    poses[:, 2] = poses[-1, 2] + (poses[:, 2] - poses[-1, 2] + np.pi) % (2.0 * np.pi) - np.pi
    lean = np.stack([sight.by_height for sight, _ in sights])
    information = []
    for (sight, driven_m), own in zip(sights, lean, strict=True):
        drift = config.drift_share * abs(way_m - driven_m)
        C = config.calibrated * (sight.covariance - np.outer(own, own)) + np.diag([drift**2, drift**2, 0.0])
        information.append(np.linalg.inv(C))
    information = np.stack(information)
    J = np.concatenate([np.tile(np.eye(3), (len(sights), 1, 1)), lean[:, :, None]], axis=2)
    prior = np.diag([0.0, 0.0, 0.0, 1.0])
    pose = np.median(poses, axis=0) if len(poses) > 2 else poses.mean(axis=0)
    state = np.append(pose, 0.0)
    for _ in range(_ROUNDS):
        off = poses - J @ state
        squared = np.einsum("ni,nij,nj->n", off, information, off)
        weight = 1.0 / (1.0 + squared / (3.0 * config.outlier_sigmas**2))
        total = prior + np.einsum("n,nki,nkl,nlj->ij", weight, J, information, J)
        state = np.linalg.solve(total, np.einsum("n,nki,nkl,nl->i", weight, J, information, poses))
    # Errors of mounts and road are the same in neighbouring frames: so many sights say no more than their root.
    return state[:3], np.linalg.inv(total)[:3, :3] * np.sqrt(len(sights)) / config.calibrated


def wrapped(angle_rad: float) -> float:
    """The angle between -pi and pi."""
    return float((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)
