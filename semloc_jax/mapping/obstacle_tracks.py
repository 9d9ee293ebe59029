"""Obstacles over many frames (room: mapping; host).

In: frames, or sights of obstacles. Out: ObstacleTrack: class, size and direction of a thing that is followed.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Drive, Frame
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.net_obstacles import NetObstacleObserver
from semloc_jax.mapping.object_tracks import ObjectTrack, ObjectTrackConfig, Tracker
from semloc_jax.mapping.obstacle_sights import Obstacle, ObstacleConfig, ObstacleObserver
from semloc_jax.perception.networks.obstacle_net import ObstacleNet

_STEP_DEG = 2.0
_FEWEST, _LEAST_SPREAD_RAD = 4, 0.35
"""Widths from fewer sides tell no direction."""
_WIDTH_SIGMA_M, _OUTLIER = 0.03, 2.0
"""Of a width, and the width of Cauchy's loss in these."""
_UNTOLD_RAD, _SQUARE = 0.2, 3.0
"""A direction that is known no better, or of a box whose sides differ by fewer sigmas, is not told."""
_TOLD_M, _CROSSED_RAD = 0.25, 0.35
"""Standard deviation of a place that one sight tells: a foot up to about 4 m away. Lines that cross at 20 deg tell a
range of 6 m to half a metre where each is a degree off: half of what one thing may be off."""
_LIKELY = 0.5 * 3.84
"""Half of chi-square of one degree of freedom at 95 %: directions that fit worse are ruled out."""


class Footprint(NamedTuple):
    """What the widths seen from many sides say of a box.

    Args:
        length_m: along its direction, the shorter side.
        width_m: across it.
        yaw_rad: its direction in odom, between -pi / 2 and pi / 2: front and back look alike.
        sigma_yaw_rad: pi / 2 where nothing tells it: few sides, or a thing that is round or square.
    """

    length_m: float
    width_m: float
    yaw_rad: float
    sigma_yaw_rad: float


@dataclass
class ObstacleTrack(ObjectTrack):
    """One thing that is followed: its place is its middle."""

    @property
    def kind(self) -> str:
        """Class of OBSTACLES; all sights agree."""
        return str(self.sights[0][0].kind)

    def footprint(self) -> Footprint:
        """Sides and direction by what is seen of them.

        A box of length L along its direction and width W across it is seen from the direction a as wide as
        L |sin(a - yaw)| + W |cos(a - yaw)|: linear in L and W for each yaw.
        """
        offset, width_m, whole = self._seen_widths()
        bearing = np.arctan2(offset[:, 1], offset[:, 0])[whole]
        typical_m = self.typical_m
        untold = Footprint(typical_m, typical_m, 0.0, 0.5 * np.pi)
        if len(bearing) < _FEWEST or _spread(bearing) < _LEAST_SPREAD_RAD:
            return untold
        yaws = np.deg2rad(np.arange(-90.0, 90.0, _STEP_DEG))
        fits = [_sides(width_m[whole], bearing - yaw) for yaw in yaws]
        cost = np.array([fit[2] for fit in fits])
        best = int(cost.argmin())
        # Turned by a right angle, the same box has its sides exchanged: its direction is that of the shorter one.
        if fits[best][0] > fits[best][1]:
            best = (best + len(yaws) // 2) % len(yaws)
        length_m, long_m, least = fits[best]
        # Widths that fit worse than they should are less sure than they say.
        limit = _LIKELY * max(2.0 * least / max(len(bearing) - 3, 1), 1.0)
        likely = np.array(
            [yaw for yaw, fit in zip(yaws, fits, strict=True) if fit[2] - least < limit and fit[0] < fit[1]]
        )
        sigma = 0.25 * _spread(2.0 * likely) / 1.96
        if sigma > _UNTOLD_RAD or long_m - length_m < _SQUARE * _WIDTH_SIGMA_M:
            return untold
        return Footprint(length_m, long_m, float(yaws[best]), float(max(sigma, np.deg2rad(_STEP_DEG))))

    @property
    def typical_m(self) -> float:
        """Median of the widths as it was seen, from wherever."""
        _, width_m, whole = self._seen_widths()
        return float(np.median(width_m[whole] if whole.any() else width_m))

    def excludes(self, other: "ObstacleTrack") -> bool:
        """Whether the middle of one stands within the other, of whatever class: nothing stands in another thing."""
        apart_m = float(np.linalg.norm(self.pose[:2] - other.pose[:2]))
        return apart_m < 0.5 * max(self.typical_m, other.typical_m)

    def _seen_widths(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of each sight the way from its camera [m], the width [m], and whether both sides were seen."""
        offset = np.array([self.pose[:2] - sight.camera_xy for sight, _ in self.sights])
        width_m = np.array([sight.span_rad for sight, _ in self.sights]) * np.linalg.norm(offset, axis=1)
        return offset, width_m, np.array([sight.is_whole for sight, _ in self.sights])

    def may_be(self, sight: Obstacle, config: ObjectTrackConfig) -> bool:
        """Whether the sight is of the same class."""
        return bool(sight.kind == self.kind)


class NetObstacleTrack(ObstacleTrack):
    """One thing that is followed by boxes of a network.

    Where a box ends too high or too low, so it does in the next frame: sights from one side are wrong together, and
    three that agree say little. A foot that is near needs no more than itself, else lines of sight have to cross.
    """

    def is_placed(self) -> bool:
        """Whether one sight tells the range by itself, or lines of sight from two places do where they cross."""
        least = min(np.linalg.eigvalsh(sight.covariance[:2, :2])[-1] ** 0.5 for sight, _ in self.sights)
        offset = np.array([self.pose[:2] - sight.camera_xy for sight, _ in self.sights])
        return bool(least < _TOLD_M or _spread(np.arctan2(offset[:, 1], offset[:, 0])) > _CROSSED_RAD)


class ObstacleFollower:
    """Finds the obstacles of one frame after the other and follows them."""

    def __init__(
        self,
        drive: Drive,
        masks: MaskSource,
        sights: ObstacleConfig | None = None,
        tracks: ObjectTrackConfig | None = None,
        net: ObstacleNet | None = None,
    ):
        """The drive, its masks, what finds obstacles in its images (None: the masks do); None for the defaults.

        Raises:
            SemlocError: the masks know no obstacles, or a camera has no images for the network.
        """
        self.observer = (
            ObstacleObserver(drive.rig, masks, sights)
            if net is None
            else NetObstacleObserver(drive, masks, net, sights)
        )
        self.tracker = Tracker(ObstacleTrack if net is None else NetObstacleTrack, tracks)

    def step(self, frame: Frame, index: int, chain: Chain) -> tuple[list[Obstacle], list[ObstacleTrack | None]]:
        """Take one frame in; returns its sights, and the track of each.

        Args:
            frame: the frame.
            index: its place in the chain.
            chain: the way of the drive.
        """
        seen = self.observer.at(frame, index, chain.Ts_odom_base)
        visible = np.array([seen.shows(t.kind, t.pose[:2]) for t in self.tracker.tracks], bool)
        found = self.tracker.step(seen.obstacles, frame.time_s, float(chain.way_m[index]), visible)
        return seen.obstacles, found

    def standing_in(self, corners: Float[np.ndarray, "4 2"]) -> str | None:
        """Class of a confirmed obstacle whose middle is in a convex area of odom; None for none.

        Args:
            corners: of the area, in turn [m].
        """
        sides = np.roll(corners, -1, axis=0) - corners
        for track in self.tracker.final():
            offset = track.pose[:2] - corners
            turn = sides[:, 0] * offset[:, 1] - sides[:, 1] * offset[:, 0]
            if (turn > 0.0).all() or (turn < 0.0).all():
                return track.kind
        return None


def _sides(width_m: np.ndarray, turned: np.ndarray) -> tuple[float, float, float]:
    """Length, width and cost of the best box of one direction; sides are not negative."""
    A = np.column_stack([np.abs(np.sin(turned)), np.abs(np.cos(turned))])
    sides = np.linalg.lstsq(A, width_m, rcond=None)[0]
    if sides.min() < 0.0:
        k = int(sides.argmax())
        sides = np.zeros(2)
        sides[k] = max(float(A[:, k] @ width_m) / float(A[:, k] @ A[:, k]), 0.0)
    off = (A @ sides - width_m) / (_OUTLIER * _WIDTH_SIGMA_M)
    return float(sides[0]), float(sides[1]), float(0.5 * _OUTLIER**2 * np.log1p(off**2).sum())


def _spread(angle: np.ndarray) -> float:
    """Angle that the smallest sector around some directions spans [rad]."""
    ordered = np.sort(np.mod(angle, 2.0 * np.pi))
    gaps = np.diff(np.append(ordered, ordered[0] + 2.0 * np.pi))
    return float(2.0 * np.pi - gaps.max())
