"""A localizer on drives with faults: what went wrong, whether it was noticed, how fast it was over (room: analysis;
host).

In: FaultyDrive, the results of a run on it. Out: FaultOutcome; a Markdown table.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from semloc_jax.datasets import Drive
from semloc_jax.evaluation.metrics import ALERT_LIMITS, ErrorLimit, pose_errors, within
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.localization.localizer import Localizer
from semloc_jax.localization.pipeline import Pipeline, PipelineConfig
from semloc_jax.localization.track_state import TrackResult, TrackStatus
from semloc_jax.maps import SemanticMap
from semloc_jax.simulation.faults import FaultyDrive, with_fault

MakeLocalizer = Callable[[SemanticMap, MotionLog], Localizer]


@dataclass(frozen=True)
class FaultOutcome:
    """One row of the fault matrix.

    Args:
        fault: its name.
        tracking: share of the frames called TRACKING.
        not_tracking_s: time that was not called TRACKING after the first frame that was [s].
        noticed_s: time from the begin of the fault to the first frame that is not called TRACKING [s]; nan where none
            is: the fault was ridden out.
        recovered_s: time from the end of the fault until TRACKING lasts again [s]; nan where it does not.
        max_lateral_m: largest error of a frame called TRACKING [m].
        max_longitudinal_m: the same along the vehicle [m].
        max_heading_deg: the same of the heading [deg].
        max_any_m: largest horizontal error of any frame with a pose after the first that was called TRACKING [m].
        false_confident: frames called TRACKING beyond the alert limits.
    """

    fault: str
    tracking: float
    not_tracking_s: float
    noticed_s: float
    recovered_s: float
    max_lateral_m: float
    max_longitudinal_m: float
    max_heading_deg: float
    max_any_m: float
    false_confident: int


def judge_fault(
    fault: FaultyDrive, results: Sequence[TrackResult], limit: ErrorLimit = ALERT_LIMITS[0]
) -> FaultOutcome:
    """What a run on a faulty drive comes to.

    Args:
        fault: The drive, with truth.
        results: One for each frame.
        limit: Beyond it a frame called TRACKING is false.

    Raises:
        SemlocError: the drive has no truth.
    """
    time_s = np.array([result.time_s for result in results])
    is_tracking = np.array([result.status == TrackStatus.TRACKING for result in results], dtype=bool)
    has_pose = np.array([result.fused is not None for result in results], dtype=bool)
    frames = {frame.id: frame for frame in fault.drive.frames}
    truth = [fault.drive.truth_at(frames[result.frame_id]) for result in results]
    poses = [r.fused.T_map_base if r.fused is not None else T for r, T in zip(results, truth, strict=True)]
    errors = {key: np.abs(value) for key, value in pose_errors(np.array(poses), np.array(truth)).items()}
    since = np.arange(len(results)) >= (np.argmax(is_tracking) if is_tracking.any() else len(results))
    horizontal = np.hypot(errors["lateral_m"], errors["longitudinal_m"])
    step_s = np.diff(time_s, append=time_s[-1] if len(time_s) < 2 else 2 * time_s[-1] - time_s[-2])

    def largest(values: np.ndarray, rows: np.ndarray) -> float:
        return float(np.max(values, initial=0.0, where=rows))

    return FaultOutcome(
        fault=fault.name,
        tracking=float(is_tracking.mean()),
        not_tracking_s=float(step_s[since & ~is_tracking].sum()),
        noticed_s=_first(time_s, since & (time_s >= fault.from_s) & ~is_tracking) - fault.from_s,
        recovered_s=max(_settled(time_s, is_tracking, fault.to_s) - fault.to_s, 0.0),
        max_lateral_m=largest(errors["lateral_m"], is_tracking),
        max_longitudinal_m=largest(errors["longitudinal_m"], is_tracking),
        max_heading_deg=largest(errors["heading_deg"], is_tracking),
        max_any_m=largest(horizontal, has_pose & since),
        false_confident=int(np.sum(is_tracking & ~within(errors, limit))),
    )


def fault_matrix(
    names: Sequence[str],
    drive: Drive,
    semantic_map: SemanticMap,
    source: MaskSource,
    make_localizer: MakeLocalizer,
    seed: int = 0,
) -> Iterator[FaultOutcome]:
    """One row after another: each fault on the same drive with a fresh localizer.

    Args:
        names: Of the faults.
        drive: With truth.
        semantic_map: The map.
        source: Masks.
        make_localizer: Makes the localizer of a map and a motion log.
        seed: Of the faults.

    Raises:
        SemlocError: a fault is not known or does not fit the drive.
    """
    for name in names:
        fault = with_fault(name, drive, semantic_map, seed)
        localizer = make_localizer(fault.semantic_map, MotionLog.of_drive(fault.drive))
        pipeline = Pipeline(fault.drive, source, localizer, PipelineConfig())
        yield judge_fault(fault, list(pipeline.run(fault.drive.frames)))


def to_markdown(outcomes: Sequence[FaultOutcome]) -> str:
    """The matrix as a table for a front page."""
    lines = [
        "| fault | tracking | noticed after | tracking again after | max error while TRACKING (lateral, longitudinal, "
        "heading) | max error at all | false-confident frames |",
        "|---|---|---|---|---|---|---|",
    ]
    for o in outcomes:
        most = f"{100 * o.max_lateral_m:.1f} cm, {100 * o.max_longitudinal_m:.1f} cm, {o.max_heading_deg:.2f} deg"
        lines.append(
            f"| {o.fault} | {o.tracking:.0%} | {_seconds(o.noticed_s)} | {_seconds(o.recovered_s)} | {most} | "
            f"{o.max_any_m:.2f} m | {o.false_confident} |"
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
