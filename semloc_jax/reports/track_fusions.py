"""`semloc track --fusion all`: the ways to make one pose of many, side by side on the same features (room: reports).

In: opened inputs, frames. Out: a folder with frames.csv and metrics.json for each way; fusions.csv and fusions.md.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from semloc_jax.datasets import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.inertial_fusion import InertialFusion
from semloc_jax.fusion.kalman import KalmanFusion
from semloc_jax.fusion.measurements import Fusion, SingleFrameFusion
from semloc_jax.fusion.window import SlidingWindow, WindowConfig
from semloc_jax.localization.beginning import rehearse
from semloc_jax.localization.track_state import TrackStatus
from semloc_jax.reports.tables import write_csv
from semloc_jax.reports.track_log import TrackLog, TrackTable
from semloc_jax.reports.track_metrics import integrity_metrics
from semloc_jax.storage import write_text

if TYPE_CHECKING:
    from semloc_jax.localization.pipeline import Pipeline

FUSIONS: dict[str, Callable[[], Fusion]] = {
    "window": SlidingWindow,
    "dropping": lambda: SlidingWindow(WindowConfig(marginalise=False)),
    "kalman": KalmanFusion,
    "inertial": InertialFusion,
    "single": SingleFrameFusion,
}
"""Fusions by name; `dropping` is a window that drops its oldest state instead of marginalising it."""


@dataclass(frozen=True)
class FusionRow:
    """One way to fuse: errors of all frames with a pose, consistency of its sigmas, share of frames called TRACKING."""

    fusion: str
    lateral_mean_m: float
    lateral_p95_m: float
    longitudinal_mean_m: float
    longitudinal_p95_m: float
    heading_mean_deg: float
    heading_p95_deg: float
    in_3_sigma: float
    nees: float
    tracking: float
    false: int
    fuse_ms: float


def write_comparison(
    pipelines: "dict[str, Pipeline]", frames: Sequence[Frame], folder: Path, progress: Callable
) -> list[FusionRow]:
    """Run every tracker through the same frames, write the results of each, and return the rows of the table.

    Args:
        pipelines: By fusion; they share drive and masks, each has its own localizer.
        frames: In time order.
        progress: Wraps an iterable of frames.

    Raises:
        SemlocError: the drive has no truth to compare with.
    """
    first = next(iter(pipelines.values()))
    if first.drive.truth is None:
        raise SemlocError(f"--fusion all: drive {first.drive.name} has no true poses; expected some to compare with")
    logs, states, is_initialised = {}, {}, dict.fromkeys(pipelines, False)
    for name, pipeline in pipelines.items():
        rehearse(pipeline.localizer.fusion)
        (folder / name).mkdir(parents=True, exist_ok=True)
        logs[name], states[name] = TrackLog(folder / name, first.drive), pipeline.localizer.start()
    before_s = -np.inf
    for frame in progress(frames):
        features = first.features(frame, before_s)
        for name, pipeline in pipelines.items():
            without = is_initialised[name] and not pipeline.config.gnss_after_init
            given = features._replace(fixes=()) if without else features
            states[name], result = pipeline.localizer.step(states[name], given)
            is_initialised[name] |= result.status == TrackStatus.TRACKING
            logs[name].append(frame, result)
        before_s = frame.time_s
    rows = []
    for name, log in logs.items():
        log.close()
        rows.append(_row(name, TrackTable.read(folder / name)))
    columns = [field.name for field in fields(FusionRow)]
    write_csv(folder / "fusions.csv", columns, [list(asdict(row).values()) for row in rows])
    write_text(folder / "fusions.md", to_markdown(rows) + "\n")
    return rows


def _row(name: str, table: TrackTable) -> FusionRow:
    known = table.has_pose
    errors = [np.abs(values) for values in table.errors(known).values()]
    metrics = {metric.key: metric.value for metric in integrity_metrics(table)}
    figures = [f for values in errors for f in (float(values.mean()), float(np.percentile(values, 95)))]
    return FusionRow(
        name,
        *figures,
        metrics["integrity.in_3_sigma"],
        metrics["integrity.nees"],
        float(table.is_tracking.mean()),
        int(metrics["tracking.false"]),
        float(np.nanmean(table.columns["fuse_ms"])),
    )


def to_markdown(rows: Sequence[FusionRow]) -> str:
    """The rows as a Markdown table."""
    lines = [
        "| fusion | lateral mean / p95 [cm] | longitudinal [cm] | heading [deg] | within 3 sigma | NEES | TRACKING | "
        "false | fusing [ms] |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        cm = [f"{100 * mean:.2f} / {100 * p95:.1f}" for mean, p95 in _pairs(r)]
        heading = f"{r.heading_mean_deg:.3f} / {r.heading_p95_deg:.3f}"
        lines.append(
            f"| {r.fusion} | {cm[0]} | {cm[1]} | {heading} | {r.in_3_sigma:.1%} | {r.nees:.2f} | {r.tracking:.1%} | "
            f"{r.false} | {r.fuse_ms:.1f} |"
        )
    return "\n".join(lines)


def _pairs(row: FusionRow) -> tuple[tuple[float, float], tuple[float, float]]:
    return (row.lateral_mean_m, row.lateral_p95_m), (row.longitudinal_mean_m, row.longitudinal_p95_m)
