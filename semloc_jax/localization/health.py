"""Whether the pose of a frame may be trusted, and whether the vehicle is lost (room: localization; host).

In: what a frame measured, counters, the fused pose. Out: reasons, counters, TrackStatus.
The three rules for lost are those of arXiv 2107.02557: outside of the map, too many failed alignments, occluded for too
long; satellite fixes that contradict the pose are a fourth.
"""

from dataclasses import dataclass, field

import numpy as np

from semloc_jax.alignment.level_choice import INLIER_LIMITS
from semloc_jax.evaluation.held import held_directions
from semloc_jax.evaluation.metrics import ErrorLimit
from semloc_jax.localization.frame_alignment import Alignment
from semloc_jax.localization.integrity import IntegrityConfig, ProtectionLevels
from semloc_jax.localization.track_state import Counters, TrackStatus
from semloc_jax.structs import STATUS_TEXT, SolveStatus


@dataclass(frozen=True)
class HealthConfig:
    """Limits of the rules. All values are ours."""

    max_cost: float = 0.78
    min_inlier_ratio: float = INLIER_LIMITS.tracked
    min_coverage: float = 0.15
    min_in_view_px: float = 150.0
    """Less map in view than this cannot contradict anything."""
    min_usable_share: float = 0.25
    """An image with fewer usable pixels is occluded."""
    max_failures: float = 8.0
    """Lost (b): failed alignments, each good one takes half of one back."""
    max_occluded: float = 40.0
    """Lost (c): occluded frames in a row."""
    max_off_map: float = 4.0
    """Lost (a): frames in a row outside of the map."""
    off_map_m: float = 10.0
    """Farther from every element than this is outside of the map, unless enough of it is in view all the same."""
    max_conflicts: float = 3.0
    """Lost: satellite fixes in a row that contradict the pose."""
    conflict_m: float = 6.0
    """Fixes that are nearer than this, or within five of their sigmas, do not contradict."""
    max_refused: float = 0.5
    """Contradictions (frames, less those that agreeing frames cancelled) up to which the pose is called tracked."""
    frozen_m: float = 0.3
    """Masks that are identical over this way come from a camera that has stopped."""
    integrity: IntegrityConfig = field(default_factory=IntegrityConfig)


def no_counts() -> Counters:
    """Counters at the start."""
    return Counters(failures=np.float64(0.0), occluded=np.int64(0), conflicts=np.int64(0), off_map=np.int64(0))


def frame_problems(found: Alignment, usable_share: float, config: HealthConfig) -> tuple[bool, tuple[str, ...]]:
    """Whether the frame was occluded, and every reason not to use what it measured."""
    if found.status in (SolveStatus.NOT_FINITE,):
        return False, (STATUS_TEXT[found.status],)
    if usable_share == 0.0:  # nothing can be held against a pose
        return True, ("the masks show nothing",)
    occluded = (
        usable_share < config.min_usable_share
        or found.coverage < config.min_coverage
        or found.in_view_px < config.min_in_view_px
        or found.status == SolveStatus.NO_EVIDENCE
    )
    if occluded:
        return True, (f"occluded: {found.coverage:.0%} of the map in view falls on usable pixels",)
    if found.cost > config.max_cost or found.inlier_ratio < config.min_inlier_ratio:
        return False, (f"poor fit: cost {found.cost:.2f}, {found.inlier_ratio:.0%} of the map in view explained",)
    return False, ()


def lost_because(counters: Counters, config: HealthConfig) -> tuple[str, ...]:
    """Every rule that says lost."""
    found = []
    if counters.off_map > config.max_off_map:
        found.append("outside of the map")
    if counters.failures > config.max_failures:
        found.append(f"{float(counters.failures):.0f} alignments failed")
    if counters.occluded > config.max_occluded:
        found.append(f"{float(counters.occluded):.0f} frames in a row are occluded")
    if counters.conflicts >= config.max_conflicts:
        found.append(f"{float(counters.conflicts):.0f} satellite fixes in a row contradict the pose")
    return tuple(found)


def counted(counters: Counters, occluded: bool, accepted: bool) -> Counters:
    """Counters after a frame."""
    if accepted:
        return counters._replace(failures=np.maximum(counters.failures - 0.5, 0.0), occluded=np.int64(0))
    if occluded:
        return counters._replace(occluded=counters.occluded + 1)
    return counters._replace(failures=counters.failures + 1.0)


def held_of(protection: ProtectionLevels, limit: ErrorLimit, may_be_elsewhere: bool) -> tuple[str, ...]:
    """The directions within their alert limits; a period of the markings away is elsewhere along the road only."""
    limits = (limit.lateral_m, limit.longitudinal_m, limit.heading_deg)
    return held_directions(protection, limits, ("along",) if may_be_elsewhere else ())


def status_of(num_tracks: int, is_confirmed: bool, reasons: tuple[str, ...]) -> TrackStatus:
    """The status of a frame that has a pose and is not lost."""
    if num_tracks > 1 or not is_confirmed:
        return TrackStatus.INITIALIZING
    return TrackStatus.DEGRADED if reasons else TrackStatus.TRACKING
