"""Obstacles in single frames, from masks on the cylinder (room: mapping; host).

In: frames, masks, poses in odom. Out: Obstacle: class, place with covariance; and which places a frame shows.
The foot of a thing says where it stands; its box on the cylinder is upright, so that the middle of it lies above.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.cameras import Rig
from semloc_jax.datasets import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.looking import hiding_ids
from semloc_jax.mapping.road_heights import RoadHeights
from semloc_jax.perception.class_table import UNLABELED_ID
from semloc_jax.perception.cylinder_view import CylinderView, GroundSight
from semloc_jax.perception.ground_contact import SightErrors, along_and_across
from semloc_jax.perception.obstacle_classes import OBSTACLES, obstacle_ids

Input = Literal["cylinder", "fisheye"]
_REACH_M = 25.0
"""How far along the way the road is known around a pose."""
_JUMP = 1.25
"""Ranges of neighbouring columns of one foot differ by a smaller factor; a farther thing stands behind."""
_BELOW_PX = 3
"""So far below a foot the road must be seen: masks have wobbly rims."""
_DIRECTION_SIGMA_RAD = np.pi
"""One frame does not tell which way a thing faces."""
_LEAST_RANGE_M = 0.3
_HALF_SIGMA = 0.1
"""Half of the width of a square seen askew is this much off its half depth, as a share of the width."""


@dataclass(frozen=True)
class ObstacleConfig:
    """How obstacles of single frames are found. All values are ours.

    Args:
        input: boxes of the cylinder, or for comparison of the image as it is.
        errors: of one sight.
        range_m: nothing farther off is told: a metre of road is few pixels there.
        min_px: pixels of one.
        min_columns: columns of one.
    """

    input: Input = "cylinder"
    errors: SightErrors = field(default_factory=SightErrors)
    range_m: float = 8.0
    min_px: int = 20
    min_columns: int = 4


@dataclass(frozen=True)
class Obstacle:
    """One thing as seen in one frame.

    Attributes:
        kind: class of OBSTACLES.
        pose: `float64[3]` x, y [m] of its middle and 0: one frame does not tell its direction.
        covariance: `float64[3 3]` of the pose.
        by_height: `float64[3]`, how the pose moves where the road there is one sigma higher than thought.
        span_rad: angle between its sides.
        camera_xy: `float64[2]`, from where [m].
        is_whole: whether both of its sides were seen.
    """

    kind: str
    pose: Float[np.ndarray, " 3"]
    covariance: Float[np.ndarray, "3 3"]
    by_height: Float[np.ndarray, " 3"]
    span_rad: float
    camera_xy: Float[np.ndarray, " 2"]
    is_whole: bool


class _Patch(NamedTuple):
    """A thing in an image: its box, and whether its sides and its top are its own."""

    box: tuple[float, float, float, float]
    is_whole: bool
    has_top: bool


@dataclass(frozen=True)
class ObstacleFrame:
    """The obstacles of one frame in odom, and what of the road it shows."""

    obstacles: list[Obstacle]
    views: Sequence[CylinderView]
    hidden: list[Bool[np.ndarray, "_h _w"]]
    heights: RoadHeights
    T_odom_base: Float[np.ndarray, "4 4"]
    range_m: float

    def shows(self, kind: str, xy_odom: Float[np.ndarray, " 2"]) -> bool:
        """Whether a camera sees the road where such a thing stands: whether a thing there could be missed."""
        xy = self.T_odom_base[:2, :2].T @ (xy_odom - self.T_odom_base[:2, 3])
        depth_m = OBSTACLES[kind].depth_m[0]
        for view, hidden in zip(self.views, self.hidden, strict=True):
            offset = xy - view.T_base_cam[:2, 3]
            range_m = float(np.linalg.norm(offset))
            if not _LEAST_RANGE_M < range_m < self.range_m:
                continue
            near = xy - depth_m / range_m * offset
            z = self.heights.at(np.stack([near, xy])).astype(np.float64)
            uv, shown = view.foot(np.column_stack([np.stack([near, xy]), z]))
            u, v = np.rint(np.where(shown[:, None], uv, 0.0)).astype(int).T
            if shown.all() and not hidden[v, u].any():
                return True
        return False


class ObstacleObserver:
    """Finds the obstacles of one frame after the other."""

    def __init__(self, rig: Rig, masks: MaskSource, config: ObstacleConfig | None = None):
        """The cameras of a drive and its masks.

        Raises:
            SemlocError: the masks know no obstacles, or a camera sees no ground.
        """
        self.config, self.masks = config or ObstacleConfig(), masks
        self.ids = obstacle_ids(masks.table)
        self._require_classes()
        rig = masks.camera_rig(rig.select(masks.cameras))
        poses = np.asarray(rig.T_base_cam, np.float64)
        self.views = [CylinderView.of(camera, T) for camera, T in zip(rig.cameras, poses, strict=True)]
        self._hides = hiding_ids(masks.table)
        self._hides[UNLABELED_ID] = True

    def _require_classes(self) -> None:
        if not self.ids:
            raise SemlocError(
                f"masks {self.masks.name}: class table {self.masks.table.name} knows no obstacles "
                f"({', '.join(OBSTACLES)}); give masks that show some, a class table that names them, or --front net"
            )

    def at(self, frame: Frame, index: int, Ts_odom_base: Float[np.ndarray, "n 4 4"]) -> ObstacleFrame:
        """The obstacles of a frame.

        Args:
            frame: the frame.
            index: its place among the poses.
            Ts_odom_base: pose of every frame.
        """
        return self.seen(self.masks.masks(frame), self._heights(index, Ts_odom_base), Ts_odom_base[index])

    def _heights(self, index: int, Ts_odom_base: Float[np.ndarray, "n 4 4"]) -> RoadHeights:
        return RoadHeights.of(Ts_odom_base, index, _REACH_M)

    def seen(
        self, masks: Sequence[UInt8[np.ndarray, "_h _w"]], heights: RoadHeights, T: Float[np.ndarray, "4 4"]
    ) -> ObstacleFrame:
        """The obstacles that the masks of all cameras show; what two of them show is one thing.

        Args:
            masks: in the order of the cameras.
            heights: of the road around the vehicle.
            T: T_odom_base of the vehicle.
        """
        found, hidden = [], []
        for view, mask in zip(self.views, masks, strict=True):
            top = view.warp(mask, UNLABELED_ID)
            hidden.append(self._hides[top])
            for kind, ids in self.ids.items():
                for patch in self._patches(view, mask, top, ids):
                    sight = self._sight(kind, patch, view, heights, T)
                    if sight is not None:
                        found.append(sight)
        return ObstacleFrame(once(found), self.views, hidden, heights, T, self.config.range_m)

    def _patches(
        self, view: CylinderView, mask: UInt8[np.ndarray, "h w"], top: UInt8[np.ndarray, "i j"], ids: tuple[int, ...]
    ) -> list[_Patch]:
        """The things of one class on the cylinder; their feet are those of the image as it is where that is asked."""
        if self.config.input == "cylinder":
            return patches(np.isin(top, ids), self._hides[top], float(view.cylinder.cy), self.config)
        found = []
        for patch in patches(np.isin(mask, ids), self._hides[mask], -np.inf, self.config):
            left, high, right, low = patch.box
            ends = np.array([[0.5 * (left + right), low], [0.5 * (left + right), high], [left, low], [right, low]])
            uv, shown = view.from_camera(ends)
            if shown.all():
                box = (uv[0, 0] - 0.5 * np.ptp(uv[2:, 0]), uv[1, 1], uv[0, 0] + 0.5 * np.ptp(uv[2:, 0]), uv[0, 1])
                found.append(patch._replace(box=tuple(float(value) for value in box)))
        return found

    def _sight(
        self, name: str, patch: _Patch, view: CylinderView, heights: RoadHeights, T: np.ndarray
    ) -> Obstacle | None:
        """The thing in odom; None where its foot is too far off."""
        (left, high, right, low), kind = patch.box, OBSTACLES[name]
        foot = np.array([0.5 * (left + right), low])
        standing = self._standing(name, foot, high if patch.has_top else None, view, heights)
        if standing is None:
            return None
        range_m = float(np.linalg.norm(standing.xy_base - view.T_base_cam[:2, 3]))
        span_rad = (right - left) / float(view.cylinder.fx)
        depth_m, sigma_m = kind.depth_m
        if kind.is_square and patch.is_whole:
            depth_m, sigma_m = 0.5 * span_rad * range_m, _HALF_SIGMA * span_rad * range_m
        # Of what is seen in part, the middle is off to the side by a part of its width.
        aside_m = 0.0 if patch.is_whole else kind.depth_m[0]
        return self._obstacle(name, standing, (depth_m, sigma_m, aside_m), (span_rad, patch.is_whole), view, T)

    def _standing(
        self, name: str, foot: Float[np.ndarray, " 2"], top_v: float | None, view: CylinderView, heights: RoadHeights
    ) -> GroundSight | None:
        """Where on the road a foot is; None where that is too far off."""
        road_m = 0.0
        for _ in range(3):  # with the height of the road where the foot turned out to be
            sight = view.ground(foot, self.config.errors, top_v, OBSTACLES[name].height_m, road_m)
            if not np.linalg.norm(sight.xy_base - view.T_base_cam[:2, 3]) < self.config.range_m:
                return None
            road_m = float(heights.at(sight.xy_base[None])[0])
        return sight

    def _obstacle(
        self,
        name: str,
        standing: GroundSight,
        middle_m: tuple[float, float, float],
        seen: tuple[float, bool],
        view: CylinderView,
        T: Float[np.ndarray, "4 4"],
    ) -> Obstacle:
        """The thing in odom.

        Args:
            name: its class.
            standing: where its foot is.
            middle_m: how far its middle is behind the foot, and the standard deviations along the line of sight and
                across it.
            seen: angle between its sides, and whether both were seen.
            view: the camera.
            T: T_odom_base of the vehicle.
        """
        camera, (depth_m, sigma_m, aside_m) = view.T_base_cam[:2, 3], middle_m
        sight = (standing.xy_base - camera) / np.linalg.norm(standing.xy_base - camera)
        covariance = np.diag([0.0, 0.0, _DIRECTION_SIGMA_RAD**2])
        R, t = T[:2, :2], T[:2, 3]
        own = standing.covariance + along_and_across(sight, sigma_m**2, aside_m**2)
        covariance[:2, :2] = R @ own @ R.T
        pose = np.array([*(t + R @ (standing.xy_base + depth_m * sight)), 0.0])
        lean = np.append(R @ standing.by_height, 0.0)
        return Obstacle(name, pose, covariance, lean, seen[0], t + R @ camera, seen[1])


def patches(
    shows: Bool[np.ndarray, "h w"], hides: Bool[np.ndarray, "h w"], horizon_v: float, config: ObstacleConfig
) -> list[_Patch]:
    """Boxes of the things in one binary image whose foot is seen, one for each thing that stands at one range.

    Args:
        shows: where things of one class are.
        hides: where something stands upright, or nothing is known.
        horizon_v: row of the horizon; -inf where there is none, and things behind one another are not told apart.
        config: sizes that count.
    """
    if not shows.any():
        return []
    num, labels, stats, _ = cv2.connectedComponentsWithStats(shows.astype(np.uint8), connectivity=8)
    found = []
    for index in range(1, num):
        x, y, width, height, area = (int(value) for value in stats[index])
        if area < config.min_px or width < config.min_columns:
            continue
        own = labels[y : y + height, x : x + width] == index
        low = y + height - 1 - own[::-1].argmax(axis=0)
        for first, last in _at_one_range(low, horizon_v):
            if last - first + 1 < config.min_columns:
                continue
            part = own[:, first : last + 1]
            # Beside a nearer thing of its class its own side is not seen.
            cut = (
                first > 0 and bool(low[first - 1] > low[first]),
                last < width - 1 and bool(low[last + 1] > low[last]),
            )
            patch = _box(part, (x + first, y), low[first : last + 1], hides & ~shows, cut)
            if patch is not None:
                found.append(patch)
    return found


def _at_one_range(low: np.ndarray, horizon_v: float) -> list[tuple[int, int]]:
    """First and last column of each piece of a lower border whose range, 1 / (v - horizon), does not jump."""
    if not np.isfinite(horizon_v):
        return [(0, len(low) - 1)]
    below = np.maximum(low - horizon_v, 0.5)
    smooth = cv2.medianBlur(below.astype(np.float32)[None], 3)[0] if len(below) >= 3 else below
    jumps = np.flatnonzero(np.abs(np.diff(np.log(smooth))) > np.log(_JUMP)) + 1
    edges = [0, *jumps.tolist(), len(low)]
    return [(a, b - 1) for a, b in pairwise(edges)]


def _box(
    own: np.ndarray, corner: tuple[int, int], low: np.ndarray, blocked: np.ndarray, cut: tuple[bool, bool]
) -> _Patch | None:
    """The box of one thing; None where its foot is hidden or cut by the border of the image, or both of its sides."""
    x, y = corner
    height, width = blocked.shape
    foot_v = _foot(low)
    row = round(foot_v)
    middle = x + own.shape[1] // 2
    below = slice(max(middle - 1, 0), middle + 2)
    if row + _BELOW_PX >= height or blocked[row + 1 : row + 1 + _BELOW_PX, below].mean() > 0.5:
        return None
    left, right = x, x + own.shape[1] - 1
    sides = [
        not is_cut and 0 <= at < width and not blocked[max(row - 1, 0) : row + 1, at].any()
        for at, is_cut in zip((left - 2, right + 2), cut, strict=True)
    ]
    if not any(sides):
        return None
    high = y + int(own.any(axis=1).argmax())
    # A pixel covers half a step to either side of its middle.
    return _Patch((left - 0.5, high - 0.5, right + 0.5, foot_v + 0.5), all(sides), high > 1)


def _foot(low: np.ndarray) -> float:
    """Row of the middle of the lower border, the gap between two feet bridged: that of its convex hull.

    Seen askew, the nearest corner of a thing is nearer than the middle of its front; seen from aside, a folding sign
    has nothing below its middle.
    """
    smooth = cv2.medianBlur(low.astype(np.float32)[None], 3)[0]
    middle = 0.5 * (len(low) - 1)
    at = np.arange(len(low))
    left, right = at[at <= middle], at[at >= middle]
    span = np.maximum(right[None] - left[:, None], 1e-9)
    share = np.where(right[None] > left[:, None], (middle - left[:, None]) / span, 0.0)
    return float((smooth[left][:, None] * (1.0 - share) + smooth[right][None] * share).max())


def once(found: list[Obstacle]) -> list[Obstacle]:
    """Of sights of two cameras that may be one thing the one that is better known."""
    kept: list[Obstacle] = []
    for sight in sorted(found, key=lambda s: float(np.trace(s.covariance[:2, :2]))):
        gaps = [(sight.pose - k.pose)[:2] for k in kept if k.kind == sight.kind]
        spreads = [(sight.covariance + k.covariance)[:2, :2] for k in kept if k.kind == sight.kind]
        if not any(gap @ np.linalg.solve(S, gap) < 9.21 for gap, S in zip(gaps, spreads, strict=True)):
            kept.append(sight)
    return kept
