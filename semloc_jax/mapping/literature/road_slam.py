"""Road-SLAM: sub-maps of classified marks, 2-point RANSAC, ICP, pose graph (room: mapping; host).

In: a drive, its masks or images, chain and gauge. Out: LiteratureMap.
Jeong, Cho, Kim, Road-SLAM: Road Marking based SLAM with Lane-level Accuracy, IV 2017: marks are classified by a random
forest over ESF; a sub-map opens at an informative one and holds up to 60 m; sub-maps meet by marks of the same class,
then by ICP.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from semloc_jax.alignment.class_icp import ClassPoints, IcpConfig, align_points
from semloc_jax.datasets import Drive
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.found_loops import FoundLoop
from semloc_jax.mapping.gauge import Gauge
from semloc_jax.mapping.literature.mark_forest import ForestConfig, MarkForest
from semloc_jax.mapping.literature.mark_pairs import MarkPairsConfig, SeenMark, merged, motion_by_pairs
from semloc_jax.mapping.literature.mark_views import MarkViews
from semloc_jax.mapping.literature.point_loops import PLANE, LiteratureMap, found_loop, loops_by
from semloc_jax.mapping.literature.point_maps import PointMapConfig, PointMaps, frames_by_way
from semloc_jax.mapping.revisits import Revisit
from semloc_jax.simulation.mark_samples import MarkKind
from semloc_jax.structs import ElementClass

INFORMATIVE = (MarkKind.ARROW, MarkKind.NUMBER, MarkKind.CROSSWALK)
"""Marks that are rare enough to open a sub-map and to tell places apart."""
_LABEL = {
    MarkKind.ARROW: ElementClass.ROAD_MARK,
    MarkKind.NUMBER: ElementClass.ROAD_MARK,
    MarkKind.CROSSWALK: ElementClass.CROSSWALK,
}
"""What their points are in the map; all else is a lane."""


@dataclass(frozen=True)
class RoadSlamConfig:
    """How sub-maps are made and met."""

    points: PointMapConfig = field(default_factory=lambda: PointMapConfig(every_m=2.0, stretch_m=60.0))
    """A sub-map is up to 60 m long; the paper's. A look every 2 m is ours."""
    forest: ForestConfig = field(default_factory=ForestConfig)
    pairs: MarkPairsConfig = field(default_factory=MarkPairsConfig)
    icp: IcpConfig = field(default_factory=IcpConfig)
    min_inlier_ratio: float = 0.7
    max_rms_m: float = 0.15


@dataclass(frozen=True)
class MarkMaps:
    """What the frames of a drive saw: points by frame, informative marks along the way."""

    maps: PointMaps
    marks: Sequence[SeenMark]

    def around(self, frame: int, first_m: float, last_m: float) -> list[SeenMark]:
        """The informative marks of a stretch of the way [m], in the base frame of `frame`, merged over the frames."""
        chain = self.maps.chain
        T_base_odom = rigid.inverse(chain.Ts_odom_base[frame])
        here = [mark for mark in self.marks if first_m <= chain.way_m[mark.frame] <= last_m]
        return merged([mark.moved(T_base_odom @ chain.Ts_odom_base[mark.frame]) for mark in here])


def road_slam_map(
    drive: Drive,
    masks: MaskSource,
    chain: Chain,
    gauge: Gauge,
    config: RoadSlamConfig | None = None,
    told: Callable[[Iterable, str], Iterable] = lambda items, _: items,
) -> LiteratureMap:
    """The map of a drive as Road-SLAM makes it.

    Args:
        drive: the drive.
        masks: what its cameras see; `classical` takes the images.
        chain: its way by its own sensors.
        gauge: what fixes the frame of the map.
        config: None for the defaults.
        told: wraps frames and groups of frames, to show progress; takes what it is about.

    Raises:
        SemlocError: scikit-learn is not installed, the masks show no paint, or a camera shows no road.
    """
    config = config or RoadSlamConfig()
    forest = MarkForest.grown(config.forest)
    seen = gathered_marks(drive, masks, chain, forest, config, lambda items: told(items, "road-slam: looking"))

    def match(revisit: Revisit, T_a_b: np.ndarray) -> FoundLoop | None:
        return matched(seen, revisit, T_a_b, config)

    found, solution = loops_by(
        match, chain, lambda loops: gauge.solve(chain, loops), told=lambda items: told(items, "road-slam: loops")
    )
    return LiteratureMap(solution.Ts_map_base, found, seen.maps.in_map(solution.Ts_map_base))


def gathered_marks(
    drive: Drive,
    masks: MaskSource,
    chain: Chain,
    forest: MarkForest,
    config: RoadSlamConfig,
    told: Callable[[Iterable], Iterable] = iter,
) -> MarkMaps:
    """Points and informative marks of all frames that look; arguments as `road_slam_map` has them."""
    views = MarkViews(drive, masks, config.forest.marks)
    frames = frames_by_way(chain.way_m, config.points.every_m)
    points, marks = [], []
    for index in told(frames):
        shown = views.of(drive.frames[index]).marks
        small = [mark.is_whole and mark.size_m[0] <= config.forest.marks.max_length_m for mark in shown]
        kinds = np.full(len(shown), int(MarkKind.OTHER))
        kinds[small] = forest.kinds([mark for mark, one in zip(shown, small, strict=True) if one])
        parts = []
        for mark, kind in zip(shown, (MarkKind(int(k)) for k in kinds), strict=True):
            if kind == MarkKind.NONE:
                continue
            label = _LABEL.get(kind, ElementClass.LANE_MARKING)
            parts.append(ClassPoints.of(mark.xy, np.full(len(mark.xy), int(label))))
            if kind in INFORMATIVE:
                marks.append(SeenMark(int(index), int(kind), mark.middle, 1))
        points.append(ClassPoints.joined(parts).thinned(config.points.voxel_m))
    return MarkMaps(PointMaps(chain, frames, points, config.points), marks)


def matched(seen: MarkMaps, revisit: Revisit, T_a_b: np.ndarray, config: RoadSlamConfig) -> FoundLoop | None:
    """The sub-map that ends with the revisit, met with the one around the earlier pass; None without marks."""
    way_m, stretch_m = seen.maps.chain.way_m, seen.maps.config.stretch_m
    last_m, at_m = float(way_m[revisit.frames[-1]]), float(way_m[revisit.a])
    later = seen.around(revisit.b, last_m - stretch_m, last_m)
    if len(later) < 2:
        return None
    # The sub-map opens at its first informative mark.
    first_m = max(last_m - stretch_m, min(float(way_m[mark.frame]) for mark in later))
    end_m = min(at_m + 0.5 * stretch_m, first_m)
    earlier = seen.around(revisit.a, at_m - 0.5 * stretch_m, end_m)
    if len(earlier) < 2:
        return None
    reach = np.sqrt(np.diag(revisit.covariance)[PLANE])
    start = motion_by_pairs(later, earlier, T_a_b, reach, config.pairs)
    target = seen.maps.around(revisit.a, at_m - 0.5 * stretch_m, end_m)
    source = seen.maps.around(revisit.b, first_m, last_m)
    if not len(target.xy) or not len(source.xy):
        return None
    if start is None:
        refused = align_points(source, target, T_a_b, replace(config.icp, gates_m=config.icp.gates_m[-1:]))
        return found_loop(revisit, T_a_b, refused, ("no two marks of one class lie alike",))
    icp = align_points(source, target, start, config.icp)
    reasons = []
    if icp.inlier_ratio < config.min_inlier_ratio:
        reasons.append(f"{icp.inlier_ratio:.0%} of the points have a partner")
    if icp.rms_m > config.max_rms_m:
        reasons.append(f"partners are {icp.rms_m:.2f} m apart")
    return found_loop(revisit, T_a_b, icp, tuple(reasons))
