"""A localizer on drives with faults: what went wrong, whether it was noticed, how fast it was over (room: analysis;
host).

In: FaultyDrive, the results of a run on it. Out: FaultOutcome; a Markdown table.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.analysis.moved_alike import WHY, is_moved_alike
from semloc_jax.analysis.row_outcome import RowOutcome, most_told
from semloc_jax.datasets import Drive
from semloc_jax.evaluation.metrics import ALERT_LIMITS, pose_errors
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.localization.localizer import Localizer
from semloc_jax.localization.pipeline import Pipeline, PipelineConfig
from semloc_jax.localization.track_state import TrackResult, TrackStatus
from semloc_jax.maps import SemanticMap
from semloc_jax.simulation.faults import FaultyDrive, with_fault
from semloc_jax.simulation.hostile import FaultRow

MakeLocalizer = Callable[[SemanticMap, MotionLog], Localizer]


@dataclass(frozen=True)
class FaultOutcome(RowOutcome):
    """A row of a tracked drive.

    Args:
        tracking: frames called TRACKING.
        noticed_s: time from the begin of the fault to the first frame that is not called TRACKING [s]; nan where none
            is: the fault was ridden out.
        recovered_s: time from the end of the fault until TRACKING lasts again [s]; nan where it does not.
        max_any_m: largest horizontal error of any frame with a pose after the first that was called TRACKING [m].
    """

    tracking: int
    noticed_s: float
    recovered_s: float
    max_any_m: float


class JudgedRun(NamedTuple):
    """Errors and levels of a run, frame by frame: lateral [m], longitudinal [m], heading [deg].

    Args:
        time_s: of the frames.
        is_tracking: called TRACKING.
        has_pose: whether there is a pose; the errors of the others are 0.
        errors: absolute.
        levels: protection levels.
        sigmas: standard deviations that were stated.
    """

    time_s: Float[np.ndarray, " n"]
    is_tracking: Bool[np.ndarray, " n"]
    has_pose: Bool[np.ndarray, " n"]
    errors: Float[np.ndarray, "n 3"]
    levels: Float[np.ndarray, "n 3"]
    sigmas: Float[np.ndarray, "n 3"]

    @property
    def is_false(self) -> Bool[np.ndarray, " n"]:
        """Called TRACKING with an error beyond a protection level."""
        return self.is_tracking & ~(self.errors <= self.levels).all(axis=1)


def judged(drive: Drive, results: Sequence[TrackResult]) -> JudgedRun:
    """The errors of a run against the truth of its drive.

    Raises:
        SemlocError: the drive has no truth.
    """
    frames = {frame.id: frame for frame in drive.frames}
    truth = [drive.truth_at(frames[result.frame_id]) for result in results]
    poses = [r.fused.T_map_base if r.fused is not None else T for r, T in zip(results, truth, strict=True)]
    errors = pose_errors(np.array(poses), np.array(truth))
    unknown = np.full(6, np.inf)
    variance = np.array([np.diagonal(r.fused.covariance) if r.fused is not None else unknown for r in results])
    sigmas = np.sqrt(variance[:, [1, 0, 5]]) * np.array([1.0, 1.0, np.degrees(1.0)])
    return JudgedRun(
        np.array([result.time_s for result in results]),
        np.array([result.status == TrackStatus.TRACKING for result in results], dtype=bool),
        np.array([result.fused is not None for result in results], dtype=bool),
        np.abs(np.column_stack([errors[key] for key in ("lateral_m", "longitudinal_m", "heading_deg")])),
        np.array([tuple(result.protection) for result in results], dtype=np.float64),
        sigmas,
    )


def judge_fault(row: FaultRow, fault: FaultyDrive, results: Sequence[TrackResult]) -> FaultOutcome:
    """What a run on a faulty drive comes to.

    Args:
        row: The fault.
        fault: The drive, with truth.
        results: One for each frame.

    Raises:
        SemlocError: the drive has no truth.
    """
    run, limit = judged(fault.drive, results), ALERT_LIMITS[0]
    time_s, is_tracking = run.time_s, run.is_tracking
    since = np.arange(len(results)) >= (np.argmax(is_tracking) if is_tracking.any() else len(results))
    horizontal = np.hypot(run.errors[:, 0], run.errors[:, 1])
    is_right = run.has_pose & (run.errors <= [limit.lateral_m, limit.longitudinal_m, limit.heading_deg]).all(axis=1)
    worst = np.max(run.errors, axis=0, initial=0.0, where=is_tracking[:, None])
    return FaultOutcome(
        *(row.fault, row.severity, row.size, row.family, row.apart),
        frames=len(results),
        tracking=int(is_tracking.sum()),
        false=int(run.is_false.sum()),
        beyond_alert=int((is_tracking & ~is_right).sum()),
        refused_right=int((is_right & ~is_tracking).sum()),
        noticed_s=_first(time_s, since & (time_s >= fault.from_s) & ~is_tracking) - fault.from_s,
        recovered_s=max(_settled(time_s, is_tracking, fault.to_s) - fault.to_s, 0.0),
        max_lateral_m=float(worst[0]),
        max_longitudinal_m=float(worst[1]),
        max_heading_deg=float(worst[2]),
        max_any_m=float(np.max(horizontal, initial=0.0, where=run.has_pose & since)),
        reason=most_told([r.reasons for r, tracked in zip(results, is_tracking, strict=True) if not tracked]),
    )


def run_fault(
    row: FaultRow,
    drive: Drive,
    semantic_map: SemanticMap,
    source: MaskSource,
    make_localizer: MakeLocalizer,
    seed: int = 0,
) -> tuple[FaultOutcome, JudgedRun]:
    """One row of the suite, with a fresh localizer.

    Args:
        row: The fault.
        drive: With truth.
        semantic_map: The map.
        source: Masks.
        make_localizer: Makes the localizer of a map and a motion log.
        seed: Of the fault.

    Raises:
        SemlocError: the fault does not fit the drive.
    """
    fault = with_fault(row.name, drive, semantic_map, seed)
    if not row.apart and is_moved_alike(semantic_map, fault.semantic_map, source.table):
        row = replace(row, apart=WHY)
    localizer = make_localizer(fault.semantic_map, MotionLog.of_drive(fault.drive))
    results = list(Pipeline(fault.drive, source, localizer, PipelineConfig()).run(fault.drive.frames))
    return judge_fault(row, fault, results), judged(fault.drive, results)


def worst_first(outcomes: Sequence[FaultOutcome]) -> list[FaultOutcome]:
    """The outcomes with the most false frames first; those that nothing can see last, what is healthy at the top."""
    return sorted(outcomes, key=lambda o: (o.severity > 0, bool(o.apart), -o.false, -o.refused_right, o.fault))


def to_markdown(outcomes: Sequence[FaultOutcome]) -> str:
    """The rows as a table for a front page, in the order given."""
    lines = [
        "| fault | size | TRACKING | false | right and refused | noticed after | TRACKING again after | "
        "max error while TRACKING (lateral, longitudinal, heading) | max error at all | told |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for o in outcomes:
        most = f"{100 * o.max_lateral_m:.1f} cm, {100 * o.max_longitudinal_m:.1f} cm, {o.max_heading_deg:.2f} deg"
        told = "nothing can see it" if o.apart else o.reason
        lines.append(
            f"| {o.fault} | {o.size or '-'} | {o.tracking} of {o.frames} | {o.false} | {o.refused_right} | "
            f"{_seconds(o.noticed_s)} | {_seconds(o.recovered_s)} | {most} | {o.max_any_m:.2f} m | {told or '-'} |"
        )
    return "\n".join(lines)


def _seconds(value: float) -> str:
    return f"{value:.1f} s" if np.isfinite(value) else "-"


def _first(time_s: np.ndarray, rows: np.ndarray) -> float:
    return float(time_s[np.argmax(rows)]) if rows.any() else float("nan")


def _settled(time_s: np.ndarray, is_tracking: np.ndarray, to_s: float, hold: int = 3) -> float:
    """Time of the first of `hold` frames in a row called TRACKING at or after `to_s`; nan where there are none."""
    for k in range(len(time_s) - hold + 1):
        if time_s[k] >= to_s - 1e-9 and is_tracking[k : k + hold].all():
            return float(time_s[k])
    return float("nan")
