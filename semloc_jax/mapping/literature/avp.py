"""AVP-SLAM: semantic points, class-wise ICP of local maps, pose graph (room: mapping; host).

In: a drive, its masks, chain and gauge. Out: LiteratureMap.
Qin, Chen, Chen, Su, AVP-SLAM: Semantic Visual Mapping and Localization for Autonomous Vehicles in the Parking Lot, IROS
2020, arXiv 2007.01813: local maps of 30 m, loops by ICP of one against an earlier one, a pose graph over the drive.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from semloc_jax.alignment.class_icp import IcpConfig, IcpResult, align_points
from semloc_jax.datasets import Drive
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.found_loops import FoundLoop
from semloc_jax.mapping.gauge import Gauge
from semloc_jax.mapping.literature.point_loops import LiteratureMap, found_loop, loops_by
from semloc_jax.mapping.literature.point_maps import PointMapConfig, PointMaps, gathered_points
from semloc_jax.mapping.revisits import Revisit


@dataclass(frozen=True)
class AvpConfig:
    """When two local maps are a loop. The paper states no limits: these are ours."""

    points: PointMapConfig = field(default_factory=PointMapConfig)
    icp: IcpConfig = field(default_factory=IcpConfig)
    min_inlier_ratio: float = 0.6
    max_rms_m: float = 0.15
    min_classes: int = 2
    """One class alone, lines along an aisle, is alike in every aisle."""
    min_points: int = 100
    """A local map of fewer says nothing."""


def avp_map(
    drive: Drive,
    masks: MaskSource,
    chain: Chain,
    gauge: Gauge,
    config: AvpConfig | None = None,
    told: Callable[[Iterable, str], Iterable] = lambda items, _: items,
) -> LiteratureMap:
    """The map of a drive as AVP-SLAM makes it.

    Args:
        drive: the drive.
        masks: what its cameras see.
        chain: its way by its own sensors.
        gauge: what fixes the frame of the map.
        config: None for the defaults.
        told: wraps frames and groups of frames, to show progress; takes what it is about.

    Raises:
        SemlocError: the masks show no paint, or no camera shows the road.
    """
    config = config or AvpConfig()
    maps = gathered_points(drive, masks, chain, config.points, lambda items: told(items, "avp: looking"))

    def match(revisit: Revisit, T_a_b: np.ndarray) -> FoundLoop | None:
        return matched(maps, revisit, T_a_b, config)

    found, solution = loops_by(
        match, chain, lambda loops: gauge.solve(chain, loops), told=lambda items: told(items, "avp: loops")
    )
    return LiteratureMap(solution.Ts_map_base, found, maps.in_map(solution.Ts_map_base))


def matched(maps: PointMaps, revisit: Revisit, T_a_b: np.ndarray, config: AvpConfig) -> FoundLoop | None:
    """The local map that ends with the revisit, laid on the one around the earlier pass."""
    way_m = maps.chain.way_m
    half_m = 0.5 * maps.config.stretch_m
    last_m = float(way_m[revisit.frames[-1]])
    first_m = last_m - maps.config.stretch_m
    later = maps.around(revisit.b, first_m, last_m)
    at_m = float(way_m[revisit.a])
    reach_m = half_m + maps.config.range_m
    earlier = maps.around(revisit.a, at_m - reach_m, min(at_m + reach_m, first_m))
    if min(len(later.xy), len(earlier.xy)) < config.min_points:
        return None
    icp = align_points(later, earlier, T_a_b, config.icp)
    return found_loop(revisit, T_a_b, icp, tuple(against(icp, config)))


def against(icp: IcpResult, config: AvpConfig) -> Iterable[str]:
    """Everything that speaks against a match."""
    if icp.inlier_ratio < config.min_inlier_ratio:
        yield f"{icp.inlier_ratio:.0%} of the points have a partner"
    if icp.rms_m > config.max_rms_m:
        yield f"partners are {icp.rms_m:.2f} m apart"
    if len(icp.labels) < config.min_classes:
        yield f"{len(icp.labels)} classes have partners"
