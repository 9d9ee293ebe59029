"""Numbers of a tracked drive (room: reports).

In: the table of a run, its timing, the drive. Out: metrics.json and a summary.
"""

import re
from pathlib import Path

import numpy as np

from semloc_jax.alignment.scene import SceneConfig
from semloc_jax.datasets import Drive
from semloc_jax.evaluation import Metric, Trajectory, evaluate, integrity, within, write_metrics
from semloc_jax.evaluation.metrics import ALERT_LIMITS, statistics
from semloc_jax.localization.pipeline import Timing
from semloc_jax.localization.track_state import TrackStatus
from semloc_jax.maps import SemanticMap, SharedSigmas
from semloc_jax.reports.metrics import OF_VARIANT, error_table
from semloc_jax.reports.tables import ERRORS, MISLEADING, PROTECTION, SIGMAS
from semloc_jax.reports.track_log import NEES, TrackTable

_SAME_S = 1e-6
_MOST_REASONS = 3


def write_track_metrics(folder: Path, table: TrackTable, drive: Drive, timing: Timing) -> str:
    """Write metrics.json and return in words how good the poses are; nothing where the drive has no truth."""
    metrics = [*status_metrics(table), *timing_metrics(timing)]
    said = []
    reference = _reference(drive, table)
    if len(reference) and table.has_pose.any():
        errors = evaluate(table.trajectory(), reference, _SAME_S)
        held = integrity_metrics(table)
        said = [*_held_text(held, table), error_table(errors)]
        metrics = [*errors, *held, *metrics]
        variants = list(dict.fromkeys(table.variants))
        for variant in variants if len(variants) > 1 else ():
            rows = np.array([name == variant for name in table.variants])
            if (rows & table.has_pose).any():
                own = Trajectory(reference.time_s[rows], reference.T_map_base[rows])
                part = [m for m in evaluate(table.trajectory(rows), own, _SAME_S) if m.key in _OF_VARIANT]
                metrics += [Metric(f"{variant}.{m.key}", m.value, m.unit, m.direction, m.tolerance) for m in part]
    write_metrics(metrics, folder / "metrics.json")
    return "\n".join(said)


def told_apart(table: TrackTable, semantic_map: SemanticMap, scene: SceneConfig) -> str:
    """What is not in the sigmas of poses that are places in the map: how far this says that it is off around them."""
    places = table.trajectory().T_map_base[:, :2, 3]
    if scene.place_in == "earth" or not len(places):
        return ""
    stated = SharedSigmas(semantic_map.walk())
    place_m, turn_rad = np.array([stated.at(xy) for xy in places]).T
    low, high = np.degrees([turn_rad.min(), turn_rad.max()])
    return (
        f"placed in the map: beside these sigmas it states to be off on the earth by {place_m.min():.2f} to "
        f"{place_m.max():.2f} m and {low:.2f} to {high:.2f} deg; errors against the truth and NEES have that in them"
    )


def _held_text(metrics: list[Metric], table: TrackTable) -> list[str]:
    """Whether frames called TRACKING are near the truth, and whether errors are as large as was stated."""
    value = {m.key: m.value for m in metrics}
    lines = [
        f"{table.is_tracking.sum()} frames TRACKING, {value['tracking.false']:.0f} of them false "
        f"(beyond {ALERT_LIMITS[0]})"
    ]
    if "integrity.nees" in value:
        lines.append(
            f"squared errors over stated variances (NEES) {value['integrity.nees']:.2f}, expected "
            f"{value['integrity.nees_low']:.2f} to {value['integrity.nees_high']:.2f}; "
            f"beyond a protection level {100 * value['integrity.protection_violations']:.1f} % of the frames"
        )
    if "integrity.hours" in value:
        risk = [value[f"integrity.misleading_per_hour.{key}"] for key in ("stated", "below")]
        lines.append(
            f"beyond an alert limit while TRACKING: {risk[0]:.2g} times an hour as stated, less than {risk[1]:.0f} by "
            f"{3600 * value['integrity.hours']:.0f} s of it (95 %)"
        )
    return lines


_OF_VARIANT = (*OF_VARIANT, "lateral.mean", "longitudinal.mean", "heading.mean", "lateral.p95", "longitudinal.p95")


def status_metrics(table: TrackTable) -> list[Metric]:
    """Share of frames of each status."""
    num = max(len(table), 1)
    return [
        Metric(f"status.{s.name.lower()}", sum(x == s for x in table.status) / num, "share", "report")
        for s in TrackStatus
    ]


def timing_metrics(timing: Timing) -> list[Metric]:
    """Times of the stages, and how much faster than the drive the run was."""
    metrics = [Metric(f"time.{key}", value, "ms", "report") for key, value in timing.stages_ms().items()]
    metrics.append(Metric("time.realtime_factor", timing.realtime_factor, "ratio", "report"))
    return [*metrics, Metric("time.dropped", float(timing.num_dropped), "frames", "report")]


def integrity_metrics(table: TrackTable) -> list[Metric]:
    """Consistency: errors of frames called TRACKING, of sigmas and of protection levels."""
    known = table.has_pose & np.isfinite(table.columns[NEES])
    tracking = known & table.is_tracking
    errors = table.errors(tracking)
    metrics = []
    if tracking.any():
        for name, unit in (("lateral", "m"), ("longitudinal", "m"), ("heading", "deg")):
            metrics += [
                Metric(f"tracking.{m.key}", m.value, m.unit, m.direction, m.tolerance)
                for m in statistics(name, errors[f"{name}_{unit}"], unit)
            ]
    false = tracking.copy()
    false[tracking] = ~within(errors, ALERT_LIMITS[0])
    metrics.append(Metric("tracking.false", float(false.sum()), "frames", "lower"))
    everything = table.errors(known)
    for key, sigma, level in zip(ERRORS, SIGMAS, PROTECTION, strict=True):
        name, limit = key.rsplit("_", 1)[0], getattr(ALERT_LIMITS[0], key)
        of_sigma, of_level = table.columns[sigma][known], table.columns[level][known]
        metrics += integrity.integrity_metrics(name, everything[key], of_sigma, of_level, limit, tracking[known])
    if known.any():
        metrics += _of_all_directions(table, known)
    if tracking.sum() > 1:
        metrics += _per_hour(table, tracking, false)
    return metrics


def _per_hour(table: TrackTable, tracking: np.ndarray, false: np.ndarray) -> list[Metric]:
    """How often an hour of frames called TRACKING misleads: as stated, as seen, and what the true rate is below."""
    errors = np.column_stack(list(table.errors(tracking).values()))
    sigma = np.column_stack([table.columns[key][tracking] for key in SIGMAS])
    step_s = float(np.median(np.diff(table.columns["time_s"])))
    independent = integrity.independent_frames(errors / sigma)
    risk = integrity.hourly_risk(table.columns[MISLEADING][tracking], false[tracking], step_s, independent)
    key = "integrity.misleading_per_hour"
    return [
        Metric(f"{key}.stated", risk.stated, "events", "report"),
        Metric(f"{key}.seen", risk.seen, "events", "lower"),
        Metric(f"{key}.below", risk.below, "events", "report"),
        Metric("integrity.hours", risk.hours, "h", "report"),
    ]


def _of_all_directions(table: TrackTable, known: np.ndarray) -> list[Metric]:
    """NEES with its band, share inside of three sigmas and beyond a protection level, over the three directions."""
    errors = np.column_stack(list(table.errors(known).values()))
    sigma = np.column_stack([table.columns[key][known] for key in SIGMAS])
    level = np.column_stack([table.columns[key][known] for key in PROTECTION])
    report = integrity.nees(table.columns[NEES][known], 3, num_independent=integrity.independent_frames(errors / sigma))
    beyond = np.any(np.abs(errors) > level, axis=1)
    return [
        Metric("integrity.nees", report.mean, "ratio", "report"),
        Metric("integrity.nees_low", report.low, "ratio", "report"),
        Metric("integrity.nees_high", report.high, "ratio", "report"),
        Metric("integrity.in_3_sigma", integrity.sigma_coverage(errors.ravel(), sigma.ravel()), "share", "higher"),
        Metric("integrity.protection_violations", float(np.mean(beyond)), "share", "lower"),
    ]


def summary(table: TrackTable, timing: Timing) -> str:
    """A summary in one or two lines."""
    counts = {s: sum(x == s for x in table.status) for s in TrackStatus}
    said = ", ".join(f"{s.name} {count}" for s, count in counts.items() if count)
    stages = timing.stages_ms()
    speed = f"real-time factor {timing.realtime_factor:.1f}, {stages['localize.mean']:.0f} ms a frame to localize"
    dropped = f", {timing.num_dropped} frames dropped" if timing.num_dropped else ""
    lines = [f"{len(table)} frames: {said}", f"{speed} (p99 {stages['localize.p99']:.0f} ms){dropped}"]
    lines += [
        f"not tracked, {count} frame{'s' if count > 1 else ''}: {reason}" for reason, count in _commonest_reasons(table)
    ]
    return "\n".join(lines)


def _commonest_reasons(table: TrackTable) -> list[tuple[str, int]]:
    """What frames that are not tracked complain of most, numbers aside, as the newest of them says it, with counts."""
    said: dict[str, tuple[str, int]] = {}
    for status, text in zip(table.status, table.reasons, strict=True):
        if status == TrackStatus.TRACKING or not text:
            continue
        kind = re.sub(r"[-+0-9.]+", "#", text)
        said[kind] = (text, said.get(kind, ("", 0))[1] + 1)
    return sorted(said.values(), key=lambda item: -item[1])[:_MOST_REASONS]


def _reference(drive: Drive, table: TrackTable) -> Trajectory:
    """True poses of all frames of the table."""
    time_s = table.columns["time_s"]
    truth = drive.truth
    if truth is None or time_s[0] < truth.time_s[0] or time_s[-1] > truth.time_s[-1]:
        return Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
    return Trajectory(time_s, truth.interpolate(time_s))
