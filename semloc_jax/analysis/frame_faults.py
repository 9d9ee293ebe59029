"""Single frames in a hostile world: which faults make a localizer sure of a wrong place (room: analysis; host).

In: a drive, its map, masks and priors, names of faults. Out: FrameFaultOutcome of each; a table for people.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.alignment.pose_prior import PriorSource
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.analysis.row_outcome import RowOutcome, most_told
from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.metrics import ALERT_LIMITS, ErrorLimit, pose_errors, within
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.localization.frame_by_frame import localize_frames
from semloc_jax.maps import SemanticMap
from semloc_jax.simulation.faults import with_fault
from semloc_jax.simulation.hostile import PASSING, FaultRow, suite
from semloc_jax.simulation.standing_faults import ODOMETRY, TIME

MakePrior = Callable[[Drive], PriorSource]


@dataclass(frozen=True)
class FrameFaultOutcome(RowOutcome):
    """A row of single frames.

    Args:
        right: frames whose best pose is right, localized or not.
        localized: frames called localized.
    """

    right: int
    localized: int


_LIKE_A_TURN = ("camera_yaw", "principal_point", "masks_shifted")
_AS_HEADING = "one frame cannot tell it from a vehicle that is turned; faults.mount_sigma_deg states it"


def frame_rows(wanted: str) -> tuple[FaultRow, ...]:
    """The rows of the suite that a single frame can meet: it has no wheels and no clock, and nothing passes.

    Raises:
        SemlocError: there is no fault of that name.
    """
    rows = (r for r in suite(wanted) if r.family not in (TIME, ODOMETRY) and r.fault not in PASSING)
    return tuple(replace(r, apart=_AS_HEADING) if r.fault in _LIKE_A_TURN and not r.apart else r for r in rows)


def frame_fault(
    row: FaultRow,
    drive: Drive,
    semantic_map: SemanticMap,
    source: MaskSource,
    make_prior: MakePrior,
    chosen: slice,
    config: LocalizeConfig,
    seed: int = 0,
    limit: ErrorLimit = ALERT_LIMITS[0],
) -> FrameFaultOutcome:
    """What single frames make of one fault.

    Args:
        row: One of `frame_rows`.
        drive: With truth.
        semantic_map: The map.
        source: Masks.
        make_prior: The prior of a drive; that of the faulty one is asked for.
        chosen: Which frames.
        config: Of the localizer.
        seed: Of the fault.
        limit: The alert limits.

    Raises:
        SemlocError: the fault is not known or does not fit the drive, or the drive has no truth.
    """
    if drive.truth is None:
        raise SemlocError(f"drive {drive.name}: has no truth; faults are judged against one")
    fault = with_fault(row.name, drive, semantic_map, seed)
    prior = make_prior(fault.drive)
    found = localize_frames(
        fault.drive, fault.semantic_map, source, prior, fault.drive.frames[chosen], source.cameras, config
    )
    return judge_frames(row, found, [drive.truth_at(result.frame) for result in found], limit)


def judge_frames(
    row: FaultRow, found: Sequence[LocalizationResult], truth: Sequence[np.ndarray], limit: ErrorLimit
) -> FrameFaultOutcome:
    """The row of a fault from the results of its frames and their true poses T_map_base."""
    poses = np.array([r.T_map_base if np.isfinite(r.T_map_base).all() else np.eye(4) for r in found])
    errors = {key: np.abs(value) for key, value in pose_errors(poses, np.array(truth)).items()}
    is_right = within(errors, limit) & np.array([np.isfinite(r.T_map_base).all() for r in found])
    localized = np.array([r.localized for r in found], dtype=bool)
    size = np.column_stack([errors[key] for key in ("lateral_m", "longitudinal_m", "heading_deg")])
    is_bounded = (size <= np.array([r.protection for r in found])).all(axis=1)

    def largest(key: str) -> float:
        return float(np.max(errors[key], initial=0.0, where=localized))

    return FrameFaultOutcome(
        *(row.fault, row.severity, row.size, row.family, row.apart),
        frames=len(found),
        right=int(is_right.sum()),
        localized=int(localized.sum()),
        false=int((localized & ~is_bounded).sum()),
        beyond_alert=int((localized & ~is_right).sum()),
        refused_right=int((is_right & ~localized).sum()),
        max_lateral_m=largest("lateral_m"),
        max_longitudinal_m=largest("longitudinal_m"),
        max_heading_deg=largest("heading_deg"),
        reason=most_told([r.reasons for r in found if not r.localized]),
    )


def worst_first(outcomes: Sequence[FrameFaultOutcome]) -> list[FrameFaultOutcome]:
    """The outcomes with the most false frames first; those that nothing can see last, what is healthy at the top."""
    return sorted(
        outcomes,
        key=lambda o: (o.severity > 0, bool(o.apart), -o.false, -o.beyond_alert, o.localized, o.fault, o.severity),
    )


def to_markdown(outcomes: Sequence[FrameFaultOutcome]) -> str:
    """The suite as a table, in the order given."""
    return "\n".join(_lines(outcomes))


def _lines(outcomes: Sequence[FrameFaultOutcome]) -> Iterator[str]:
    yield (
        "| fault | size | localized | false | beyond alert | right but refused | "
        "largest error localized (lateral, along, heading) | told |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    for o in outcomes:
        errors = f"{o.max_lateral_m:.2f} m, {o.max_longitudinal_m:.2f} m, {o.max_heading_deg:.2f} deg"
        told = o.apart or o.reason
        yield (
            f"| {o.fault} | {o.size or '-'} | {o.localized} of {o.frames} | {o.false} | {o.beyond_alert} | "
            f"{o.refused_right} | {errors} | {told or '-'} |"
        )
